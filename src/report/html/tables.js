// Lays out tables that are wider than the page so that nothing hides: set tighter, or else a card for each row.
{
  const tables = [...document.querySelectorAll(".scroll > table")];
  const across = (cells, visit) => {
    let column = 0;
    for (const cell of cells) {
      for (let i = 0; i < cell.colSpan; i++) visit(cell, column++);
    }
  };
  for (const table of tables) {
    const labels = [];
    for (const row of table.tHead.rows) {
      across(row.cells, (cell, column) => (labels[column] = `${labels[column] ?? ""} ${cell.textContent}`.trim()));
    }
    for (const row of table.tBodies[0].rows) {
      across(row.cells, (cell, column) => (cell.dataset.label ??= labels[column] ?? ""));
    }
  }
  const isWide = (table) => table.parentElement.scrollWidth > table.parentElement.clientWidth;
  const lay = () => {
    for (const table of tables) {
      table.classList.remove("tight", "cards");
      if (isWide(table)) table.classList.add("tight");
      if (isWide(table)) table.classList.replace("tight", "cards");
    }
  };
  addEventListener("resize", lay);
  // What is closed has no width.
  document.addEventListener("toggle", lay, true);
  lay();
}
