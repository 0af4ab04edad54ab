// A picture of the scenes that are shown, by two of their figures; a point leads to its scene. `scatter` draws it anew.
const scatter = (() => {
  const [WIDTH, HEIGHT, LEFT, BOTTOM] = [640, 260, 56, 40];
  const { figures, cards } = JSON.parse(document.getElementById("index").textContent);
  const room = document.getElementById("scatter");
  const articles = [...document.querySelectorAll("article.card")];
  const values = (figure) => cards.map((card) => card.at(-1)[figure]);
  const known = figures.map((_, i) => i).filter((i) => values(i).filter((value) => value != null).length > 1);
  if (known.length < 2) return () => {};
  const names = figures.map((name) => name.replaceAll("_", " "));
  const choice = (label, chosen) => {
    const select = document.createElement("select");
    select.append(...known.map((i) => new Option(names[i], i, i === chosen, i === chosen)));
    select.onchange = () => draw();
    const whole = document.createElement("label");
    whole.append(label, select);
    return [whole, select];
  };
  const hardness = figures.indexOf("pair_min_ttc_s");
  const across = known.find((i) => i !== hardness && !/timestep|length/.test(figures[i])) ?? known.find((i) => i !== hardness);
  const up = known.includes(hardness) ? hardness : known.find((i) => i !== across);
  const [[acrossLabel, x], [upLabel, y]] = [choice("Across ", across), choice("Up ", up)];
  const picture = document.createElement("div");
  const choices = document.createElement("div");
  choices.className = "choices";
  choices.append(acrossLabel, upLabel);
  room.append(choices, picture);
  room.hidden = false;
  const draw = () => {
    const points = cards
      .map((card, i) => [card.at(-1)[x.value], card.at(-1)[y.value], i, card.at(-2).includes("accepted")])
      .filter(([u, v, i]) => u != null && v != null && !articles[i].hidden);
    const scale = (axis, from, to) => {
      const all = points.map((point) => point[axis]);
      const [low, high] = [Math.min(...all), Math.max(...all)];
      return [low, high, (value) => from + ((to - from) * (value - low)) / (high - low || 1)];
    };
    const [x0, x1, atX] = scale(0, LEFT, WIDTH - 10);
    const [y0, y1, atY] = scale(1, HEIGHT - BOTTOM, 10);
    const text = (value) => (points.length ? Number(value.toPrecision(3)).toString() : "");
    const dots = points.map(([u, v, i, isAccepted]) => {
      const title = articles[i].querySelector("h3").textContent.replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
      return `<a href="#scene-${i}" aria-label="${title}"><circle class="${isAccepted ? "accepted" : ""}" cx="${atX(u)}" cy="${atY(v)}" r="5"><title>${title}</title></circle></a>`;
    });
    picture.innerHTML = `<svg viewBox="0 0 ${WIDTH} ${HEIGHT}"><path class="axis" d="M${LEFT} 10V${HEIGHT - BOTTOM}H${WIDTH - 10}"/>` +
      `<text x="${LEFT}" y="${HEIGHT - 22}">${text(x0)}</text><text x="${WIDTH - 10}" y="${HEIGHT - 22}" text-anchor="end">${text(x1)}</text>` +
      `<text x="${LEFT - 5}" y="${HEIGHT - BOTTOM}" text-anchor="end">${text(y0)}</text><text x="${LEFT - 5}" y="18" text-anchor="end">${text(y1)}</text>` +
      `<text x="${(LEFT + WIDTH) / 2}" y="${HEIGHT - 6}" text-anchor="middle">${names[x.value]}</text>` +
      `<text transform="translate(14 ${(HEIGHT - BOTTOM) / 2}) rotate(-90)" text-anchor="middle">${names[y.value]}</text>${dots.join("")}</svg>`;
  };
  return draw;
})();
