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
  // A heading of a sortable table sorts it, the other way at the second time; rows without a number come last.
  for (const table of document.querySelectorAll(".sortable table")) {
    [...table.tHead.rows[0].cells].forEach((heading, column) => {
      const button = Object.assign(document.createElement("button"), { type: "button" });
      button.append(...heading.childNodes);
      heading.append(button);
      button.onclick = () => {
        const sign = heading.ariaSort === "ascending" ? -1 : 1;
        const key = (row) => row.cells[column].textContent.replace("\u2212", "-").replaceAll("\u202f", "");
        const compare = (a, b) => {
          const [own, other] = [key(a), key(b)];
          const [n, m] = [Number.parseFloat(own), Number.parseFloat(other)];
          if (!heading.classList.contains("n")) return sign * own.localeCompare(other);
          return Number.isFinite(m) - Number.isFinite(n) || sign * (n - m) || 0;
        };
        table.tBodies[0].append(...[...table.tBodies[0].rows].sort(compare));
        for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
        heading.ariaSort = sign > 0 ? "ascending" : "descending";
      };
    });
  }
  addEventListener("resize", lay);
  // What is closed has no width.
  document.addEventListener("toggle", lay, true);
  lay();
}
