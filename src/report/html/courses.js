// Draws how fast the road users of an event are, and how close, over time. `courses` gives an element and a function that
// marks a timestep in it.
const courses = (data, states, colors) => {
  const [WIDTH, HEIGHT, MARGIN] = [300, 90, 26];
  const { dt, present, steps, closeness = [] } = data;
  const speed = (own) => own.map((now, t) => {
    const [before, after] = [own[t - 1] ?? now, own[t + 1] ?? now];
    const n = (own[t - 1] ? 1 : 0) + (own[t + 1] ? 1 : 0);
    return now && n ? Math.hypot(after[0] - before[0], after[1] - before[1]) / (n * dt) : null;
  });
  const ofRoles = data.agents.map(([, role], a) => [role, a]).filter(([role]) => role !== null);
  const speeds = ofRoles.map(([role, a]) => [colors[role % colors.length], speed(states[a].states)]);
  const close = (i) => closeness.map((values) => values[i]);
  const plots = [["Speed (m/s)", speeds, 0, Infinity]];
  if (close(1).some((value) => value !== null)) plots.push(["Distance (m)", [["currentColor", close(1)]], present + 1, Infinity]);
  if (close(0).some((value) => value !== null)) plots.push(["Time to collision (s)", [["currentColor", close(0)]], present + 1, 10]);
  const x = (t) => MARGIN + ((WIDTH - MARGIN - 4) * t) / Math.max(1, steps - 1);
  const draw = ([title, lines, first, limit]) => {
    const most = Math.min(limit, Math.max(...lines.flatMap(([, values]) => values.filter((value) => value != null)))) || 1;
    const y = (value) => HEIGHT - 14 - ((HEIGHT - 32) * Math.min(value, most)) / most;
    const path = (values) => {
      let [text, isOpen] = ["", false];
      values.forEach((value, t) => {
        if (value != null) text += `${isOpen ? "L" : "M"}${x(t + first).toFixed(1)} ${y(value).toFixed(1)}`;
        isOpen = value != null;
      });
      return text;
    };
    return `<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="${title} over time"><text x="${MARGIN}" y="11">${title}</text>` +
      `<path class="axis" d="M${MARGIN} 18V${HEIGHT - 14}H${WIDTH - 4}"/><text x="${MARGIN - 3}" y="24" text-anchor="end">${most.toFixed(most < 10 ? 1 : 0)}</text>` +
      `<text x="${MARGIN - 3}" y="${HEIGHT - 14}" text-anchor="end">0</text><text x="${x(present)}" y="${HEIGHT - 2}" text-anchor="middle">present</text>` +
      `<path class="axis" d="M${x(present)} 18V${HEIGHT - 14}"/>${lines.map(([color, values]) => `<path class="course" stroke="${color}" d="${path(values)}"/>`).join("")}` +
      `<path class="cursor" d="M0 18V${HEIGHT - 14}"/></svg>`;
  };
  const element = document.createElement("div");
  element.className = "courses";
  element.innerHTML = plots.map(draw).join("");
  const cursors = element.querySelectorAll(".cursor");
  return [element, (timestep) => cursors.forEach((cursor) => cursor.setAttribute("transform", `translate(${x(timestep)} 0)`))];
};
