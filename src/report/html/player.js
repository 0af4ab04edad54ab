// Draws scenes that come into view from their packed states and moves their road users through time.
{
  const LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  const VALUES = new Map([...LETTERS].map((letter, value) => [letter.charCodeAt(0), value]));
  const ROLE_COLORS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];
  const [RECORDED, GENERATED] = ["#777777", "#A05C8B"];
  const DOT_STEPS = 3;
  const [LIGHTS, LIGHT_M] = [["unknown", "stop", "caution", "go"], 2.8];
  const parsed = (element) => JSON.parse(element.textContent);
  const lanesOfAll = parsed(document.getElementById("lanes"));

  // Reads the numbers that card/packed.rs writes, one at each call.
  const reader = (text) => {
    let at = 0;
    return () => {
      let [value, scale, digit] = [0, 1, 0];
      do {
        digit = VALUES.get(text.charCodeAt(at++));
        value += (digit & 31) * scale;
        scale *= 32;
      } while (digit & 32);
      return value % 2 ? -(value - 1) / 2 : value / 2;
    };
  };

  const unpackLanes = (text) => {
    const next = reader(text);
    const line = () => {
      let [x, y] = [0, 0];
      return Array.from({ length: next() }, () => [(x += next()) / 100, (y += next()) / 100]);
    };
    const lights = () => Array.from({ length: next() }, () => [next(), next(), next()]);
    return Array.from({ length: next() }, () => [line(), line(), line(), lights()]);
  };

  // One entry an agent: its states by timestep as [x, y, heading, whether it was observed], and its stretches.
  const unpackSample = (text, agents) => {
    const next = reader(text);
    return agents.map(() => {
      const [states, stretches] = [[], []];
      let [timestep, before, last] = [0, null, null];
      for (let left = next(); left > 0; left--) {
        const observed = next() === 1;
        const start = timestep + next();
        const end = start + next();
        for (timestep = start; timestep < end; timestep++) {
          const now = [0, 1, 2].map((axis) => next() + (last ? 2 * last[axis] - before[axis] : 0));
          [before, last] = [last ?? now, now];
          states[timestep] = [now[0] / 100, now[1] / 100, now[2] / 100, observed];
        }
        stretches.push([observed, start, end]);
      }
      return { states, stretches };
    });
  };

  const line = (points) => (points.length > 1 ? "M" + points.map(([x, y]) => `${x} ${-y}`).join("L") : "");
  const dots = (points) =>
    points.filter((_, i) => (points.length - 1 - i) % DOT_STEPS === 0).map(([x, y]) => `M${x} ${-y}h0`).join("");
  const placed = ([x, y, heading]) => `translate(${x} ${-y}) rotate(${(-heading * 180) / Math.PI})`;
  const box = (kind, [, , length, width], color, place) => {
    const [l, w] = [length / 2, width / 2];
    const front = kind === "now" ? `<title></title><path class="front" d="M${0.45 * l} ${-0.7 * w}L${0.9 * l} 0L${0.45 * l} ${0.7 * w}"/>` : "";
    return `<g class="${kind}" transform="${place}"><rect x="${-l}" y="${-w}" width="${length}" height="${width}" rx="0.3" fill="${color}" stroke="${color}"/>${front}</g>`;
  };

  const drawLanes = (lanes) => {
    const surface = ([, left, right]) => (left.length > 1 && right.length > 1 ? line([...left, ...right.toReversed()]) + "Z" : "");
    const all = (shape) => lanes.map(shape).join("");
    return `<path class="lane" d="${all(surface)}"/><path class="centerline" d="${all(([center]) => line(center))}"/>` +
      `<path class="border" d="${all(([, left, right]) => line(left) + line(right))}"/>`;
  };

  // A bar across the beginning of each lane that has a light; its color is set as time goes on.
  const drawLights = (lanes) =>
    lanes.map(([[[x, y] = [], [nextX, nextY] = []], , , lights], i) => {
      const half = LIGHT_M / 2 / Math.max(1e-3, Math.hypot(nextX - x, nextY - y));
      const end = (side) => [x - side * half * (nextY - y), y + side * half * (nextX - x)];
      return lights.length && nextX !== undefined ? `<path class="light" data-lane="${i}" d="${line([end(1), end(-1)])}"/>` : "";
    }).join("");
  const lightAt = (lights, timestep) => lights.find(([, first, last]) => first <= timestep && timestep <= last)?.[0] ?? 0;

  const drawScale = ([x0, y0, x1], unit) => {
    const length = [100, 50, 20, 10, 5].find((l) => l <= (x1 - x0) / 4) ?? 2;
    const [left, bottom] = [x0 + 14 * unit, -y0 - 12 * unit];
    return `<path class="scale" d="M${left} ${bottom - 6 * unit}V${bottom}H${left + length}V${bottom - 6 * unit}"/>` +
      `<text class="role" x="${left + length / 2}" y="${bottom - 6 * unit}" font-size="${14 * unit}" stroke-width="${4 * unit}" text-anchor="middle">${length} m</text>`;
  };

  // The drawing of a panel as text: only numbers and fixed words, so that names cannot become markup.
  const drawPanel = (data, [, recorded, samples], states, lanes) => {
    const [x0, y0, x1, y1] = data.view;
    const unit = (x1 - x0) / (x1 - x0 > 1.6 * (y1 - y0) ? 1000 : 500);
    const color = ([, role]) => (role === null ? (recorded ? RECORDED : GENERATED) : ROLE_COLORS[role % ROLE_COLORS.length]);
    const order = data.agents.map((_, i) => i).sort((a, b) => (data.agents[a][1] !== null) - (data.agents[b][1] !== null));
    const opacity = samples.length > 1 ? 0.6 : 1;
    const step = Math.max(1, Math.round(1 / data.dt));
    const traces = (agent, { states, stretches }, isFirst) => {
      const strong = agent[1] === null ? "" : " strong";
      let text = "";
      for (const [observed, start, end] of stretches) {
        const points = (observed ? states.slice(start, end) : states.slice(Math.max(0, start - 1), end + 1)).filter(Boolean);
        text += observed
          ? `<path class="past${strong}" d="${line(points)}"/><path class="dots${strong}" d="${dots(points)}"/>`
          : `<path class="future${strong}" d="${line(points)}" stroke="${color(agent)}" opacity="${opacity}"/>`;
      }
      for (let t = data.present + step; strong && samples.length === 1 && t < states.length - 1; t += step) {
        if (states[t]) text += box("ghost", agent, color(agent), placed(states[t]));
      }
      if (states.length > data.present + 1) {
        const last = states[states.length - 1];
        if (isFirst || !last[3]) text += box(last[3] ? "last given" : "last", agent, color(agent), placed(last));
      }
      return text;
    };
    const groups = states.map((ofSample, i) => {
      const drawn = order.filter((a) => ofSample[a].states.length > 0);
      const boxes = drawn.map((a) => box("now", data.agents[a], color(data.agents[a]), "").replace("<g ", `<g data-agent="${a}" `));
      return `<g data-sample="${i}">${drawn.map((a) => traces(data.agents[a], ofSample[a], i === 0)).join("")}${boxes.join("")}</g>`;
    });
    const labels = data.agents.map(([, role, , width], a) =>
      role === null ? "" : `<text class="role" data-label="${a}" data-lift="${0.6 * width + 6 * unit}" font-size="${15 * unit}" stroke-width="${4 * unit}" text-anchor="middle"></text>`);
    return `<svg class="scene" role="img" viewBox="${x0} ${-y1} ${x1 - x0} ${y1 - y0}"><rect class="ground" x="${x0}" y="${-y1}" width="${x1 - x0}" height="${y1 - y0}"/>` +
      `${drawLanes(lanes)}${drawLights(lanes)}${groups.join("")}${labels.join("")}${drawScale(data.view, unit)}</svg>`;
  };

  const element = (name, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(name), properties);
    made.append(...children);
    return made;
  };

  // Builds the drawings and controls of a card; returns how to take them away again.
  const build = (card) => {
    const data = parsed(card.querySelector("script"));
    const title = card.querySelector("h3").textContent;
    const panels = card.querySelector(".panels");
    const lanes = unpackLanes(lanesOfAll[data.lanes]);
    const states = data.panels.map(([, , samples]) => samples.map(([, text]) => unpackSample(text, data.agents)));
    const still = [...panels.childNodes];
    const nameOf = (a) => (data.agents[a][1] === null ? "" : `${data.roles[data.agents[a][1]]}: `) + `track ${data.agents[a][0]}`;
    const figures = data.panels.map((panel, p) => {
      const caption = element("figcaption", { textContent: panel[0] });
      data.roles.forEach((role, i) => {
        const swatch = element("span", { className: "swatch" });
        swatch.style.background = ROLE_COLORS[i % ROLE_COLORS.length];
        caption.append(" ", swatch, role);
      });
      const figure = element("figure", {}, caption);
      figure.insertAdjacentHTML("beforeend", drawPanel(data, panel, states[p], lanes));
      const svg = figure.querySelector("svg");
      svg.setAttribute("aria-label", `${title}, ${panel[0]}: road users from above`);
      for (const now of svg.querySelectorAll(".now")) now.querySelector("title").textContent = nameOf(now.dataset.agent);
      for (const label of svg.querySelectorAll("[data-label]")) label.textContent = data.roles[data.agents[label.dataset.label][1]];
      return figure;
    });
    panels.replaceChildren(...figures);
    panels.style.aspectRatio = "auto";
    panels.tabIndex = 0;
    panels.setAttribute("role", "group");
    panels.setAttribute("aria-label", "Player. The space bar plays and pauses, arrow keys go a step.");

    const last = Math.max(0, data.steps - 1);
    // A drive that ends sooner than the one beside it stands still at its end.
    const ends = states.map((ofPanel) => Math.max(...ofPanel.flat().map((agent) => agent.states.length)) - 1);
    const button = (text, label, onclick) => {
      const made = element("button", { type: "button", textContent: text, onclick });
      made.setAttribute("aria-label", label);
      return made;
    };
    const slider = element("input", { type: "range", min: 0, max: last, value: data.present });
    slider.setAttribute("aria-label", "Time");
    const output = element("output");
    let [timestep, timer] = [data.present, null];

    const show = (wanted) => {
      timestep = Math.min(last, Math.max(0, wanted));
      figures.forEach((figure, p) => {
        const at = Math.min(timestep, ends[p]);
        for (const bar of figure.querySelectorAll("[data-lane]")) {
          bar.setAttribute("class", `light ${LIGHTS[lightAt(lanes[bar.dataset.lane][3], at)]}`);
        }
        for (const group of figure.querySelectorAll("[data-sample]")) {
          const ofSample = states[p][group.dataset.sample];
          for (const now of group.querySelectorAll(".now")) {
            const state = ofSample[now.dataset.agent].states[at];
            now.style.display = state ? "" : "none";
            if (!state) continue;
            now.setAttribute("transform", placed(state));
            now.setAttribute("class", data.panels[p][1] || state[3] ? "now" : "now made");
          }
        }
        for (const label of figure.querySelectorAll("[data-label]")) {
          const state = states[p][0][label.dataset.label].states[at];
          label.style.display = state ? "" : "none";
          if (!state) continue;
          label.setAttribute("x", state[0]);
          label.setAttribute("y", -state[1] - label.dataset.lift);
        }
      });
      mark(timestep);
      slider.value = timestep;
      output.textContent = `${((timestep - data.present) * data.dt).toFixed(1)} s, step ${timestep + 1} of ${last + 1}`;
    };
    const stop = () => {
      cancelAnimationFrame(timer);
      timer = null;
      player.textContent = "▶";
    };
    const play = () => {
      if (timestep === last) show(0);
      const [from, began] = [timestep, performance.now()];
      const tick = (now) => {
        show(from + Math.floor((now - began) / (1000 * data.dt)));
        if (timestep === last) stop();
        else timer = requestAnimationFrame(tick);
      };
      timer = requestAnimationFrame(tick);
      player.textContent = "▮▮";
    };
    const go = (to) => { stop(); show(to); };
    const toggle = () => (timer === null ? play() : stop());
    const player = button("▶", "Play or pause", toggle);
    slider.oninput = () => go(Number(slider.value));
    const controls = element("div", { className: "player" }, button("|◀", "To the beginning", () => go(0)),
      button("◁", "A step back", () => go(timestep - 1)), player, button("▷", "A step on", () => go(timestep + 1)), slider, output);
    const samples = data.panels.at(-1)[2];
    if (samples.length > 1) {
      const choice = element("select", {}, element("option", { value: "", textContent: `all ${samples.length} samples` }),
        ...samples.map(([name], i) => element("option", { value: i, textContent: name })));
      choice.setAttribute("aria-label", "Samples that are shown");
      choice.onchange = () => {
        for (const group of figures.at(-1).querySelectorAll("[data-sample]")) {
          group.style.display = choice.value === "" || choice.value === group.dataset.sample ? "" : "none";
        }
      };
      controls.append(choice);
    }
    panels.after(controls);
    const [chart, mark] = data.roles.length && data.panels.at(-1)[2].length === 1 ? courses(data, states.at(-1)[0], ROLE_COLORS) : [null, () => {}];
    if (chart) controls.after(chart);
    const keys = { " ": toggle, ArrowLeft: () => go(timestep - 1), ArrowRight: () => go(timestep + 1), Home: () => go(0), End: () => go(last) };
    panels.onkeydown = (event) => {
      if (!(event.key in keys) || event.altKey || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      keys[event.key]();
    };
    let details = null;
    if (data.facts) {
      const facts = element("dl", { className: "facts" }, ...data.facts.map(([name, value]) =>
        element("div", {}, element("dt", { textContent: name }), element("dd", { textContent: value }))));
      details = element("details", {}, element("summary", { textContent: "Provenance and figures" }), facts);
      (chart ?? controls).after(details);
    }
    show(data.present);
    return () => {
      stop();
      panels.style.aspectRatio = `${panels.offsetWidth} / ${Math.max(1, panels.offsetHeight)}`;
      panels.replaceChildren(...still);
      controls.remove();
      chart?.remove();
      details?.remove();
    };
  };

  // Only cards near the window are drawn; those far from it are taken away again unless somebody is at work on them.
  const built = new Map();
  const draw = (card) => built.has(card) || built.set(card, build(card));
  const observer = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) draw(target);
      else if (built.has(target) && !target.contains(document.activeElement)) {
        built.get(target)();
        built.delete(target);
      }
    }
  }, { rootMargin: "800px" });
  const cards = document.querySelectorAll("article.card");
  cards.forEach((card) => observer.observe(card));
  addEventListener("beforeprint", () => cards.forEach((card) => card.hidden || !card.classList.contains("still") || draw(card)));
  for (const note of document.querySelectorAll(".script-only")) note.hidden = false;
}
