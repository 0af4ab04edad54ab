// Moves the boxes of each scene through time. Without script the drawings show the present and the end.
for (const card of document.querySelectorAll("article.card")) {
  const data = JSON.parse(card.querySelector("script[type='application/json']").textContent);
  const panels = [...card.querySelectorAll("svg.scene")];
  const controls = card.querySelector(".player");
  const [button, slider, output] = ["button", "input", "output"].map((name) => controls.querySelector(name));
  let timer = null;

  const show = (timestep) => {
    panels.forEach((svg, i) => {
      const { states, dt_s, present } = data[i];
      for (const box of svg.querySelectorAll("[data-agent]")) {
        const state = states[box.dataset.agent][timestep];
        box.style.display = state ? "" : "none";
        if (state) {
          const degrees = (-state[2] * 180) / Math.PI;
          box.setAttribute("transform", `translate(${state[0]} ${-state[1]}) rotate(${degrees})`);
        }
      }
      output.textContent = `${((timestep - present) * dt_s).toFixed(1)} s`;
    });
  };
  const stop = () => {
    clearInterval(timer);
    timer = null;
    button.textContent = "▶";
  };
  const play = () => {
    if (slider.value === slider.max) slider.value = 0;
    button.textContent = "❚❚";
    timer = setInterval(() => {
      slider.stepUp();
      show(Number(slider.value));
      if (slider.value === slider.max) stop();
    }, 1000 * data[0].dt_s);
  };
  button.addEventListener("click", () => (timer === null ? play() : stop()));
  slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
  show(Number(slider.value));
  controls.hidden = data.length === 0;
}
