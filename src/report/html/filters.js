// Shows the scenes that answer the form above them; what was chosen is kept in the address of the page.
{
  const PREFIX = "#scenes&";
  // In the order of what the page knows of each scene; of decisions it may know several.
  const CHOICES = ["sweep", "behavior", "place", "verdict", "strength", "bucket", "decision"];
  const index = JSON.parse(document.getElementById("index").textContent);
  const form = document.getElementById("filters");
  const found = document.getElementById("found");
  const cards = [...document.querySelectorAll("article.card")];

  const wanted = () => [...new FormData(form)].filter(([, value]) => value !== "");
  const answers = (card, [name, value]) => {
    const choice = CHOICES.indexOf(name);
    if (choice >= 0) return [card[choice]].flat().includes(value);
    const [figure, end] = [name.slice(0, -4), name.slice(-3)];
    const known = card[CHOICES.length][index.figures.indexOf(figure)];
    return known != null && (end === "min" ? known >= Number(value) : known <= Number(value));
  };

  const apply = () => {
    const conditions = wanted();
    let shown = 0;
    cards.forEach((card, i) => {
      card.hidden = !conditions.every((condition) => answers(index.cards[i], condition));
      shown += !card.hidden;
    });
    for (const group of form.querySelectorAll("details")) {
      const n = [...group.querySelectorAll("input")].filter((field) => field.value !== "").length;
      group.querySelector(".set").textContent = n ? `${n} set` : "";
    }
    scatter();
    found.textContent = shown === cards.length ? `All ${shown} scenes are shown.` : `${shown} of ${cards.length} scenes are shown.`;
  };
  const keep = () => {
    const conditions = new URLSearchParams(wanted()).toString();
    history.replaceState(null, "", conditions ? PREFIX + conditions : "#scenes");
  };
  const restore = () => {
    if (!location.hash.startsWith(PREFIX)) return;
    form.reset();
    for (const [name, value] of new URLSearchParams(location.hash.slice(PREFIX.length))) {
      const field = form.elements[name];
      if (!field) continue;
      field.value = value;
      const details = field.closest("details");
      if (details) details.open = true;
    }
    form.closest("details").open = true;
    document.getElementById("scenes").scrollIntoView();
    apply();
  };

  form.hidden = false;
  form.addEventListener("input", () => { apply(); keep(); });
  form.addEventListener("submit", (event) => event.preventDefault());
  document.getElementById("show-all").addEventListener("click", () => { form.reset(); apply(); keep(); });
  addEventListener("hashchange", restore);
  apply();
  restore();
}
