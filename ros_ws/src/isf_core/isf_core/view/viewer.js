// Unpacks figures of plotly when they come into sight, and adds what plotly lacks: keys, pinch, buttons, light and dark.
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const START = { eye: { x: 0.74, y: -1.02, z: 0.82 }, center: { x: 0, y: 0, z: -0.12 }, up: { x: 0, y: 0, z: 1 } };

  async function unpacked(element) {
    const bytes = Uint8Array.from(atob(element.textContent.trim()), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  }

  let library = null;
  function plotly() {
    library ??= unpacked(document.getElementById("view3d-library")).then((text) => {
      const script = document.createElement("script");
      script.textContent = text;
      document.head.append(script);
    });
    return library;
  }

  function colours() {
    const ink = dark.matches ? "#e4e9ee" : "#1f2933";
    const grid = dark.matches ? "#3a454f" : "#d3dae0";
    const axis = { color: ink, gridcolor: grid, zerolinecolor: grid, backgroundcolor: "rgba(0,0,0,0)" };
    const found = { paper_bgcolor: "rgba(0,0,0,0)", "font.color": ink };
    for (const name of ["xaxis", "yaxis", "zaxis"])
      for (const [key, value] of Object.entries(axis)) found[`scene.${name}.${key}`] = value;
    return found;
  }

  function orbit(camera, turn, rise, zoom) {
    const { x, y, z } = camera.eye;
    const c = camera.center;
    const [dx, dy, dz] = [x - c.x, y - c.y, z - c.z];
    const radius = Math.min(Math.max(Math.hypot(dx, dy, dz) * zoom, 0.15), 6);
    const height = Math.min(Math.max(Math.asin(dz / Math.hypot(dx, dy, dz)) + rise, -1.55), 1.55);
    const angle = Math.atan2(dy, dx) + turn;
    const flat = radius * Math.cos(height);
    const eye = { x: c.x + flat * Math.cos(angle), y: c.y + flat * Math.sin(angle), z: c.z + radius * Math.sin(height) };
    return { eye, center: c, up: { x: 0, y: 0, z: 1 } };
  }

  function numbers(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Int16Array(bytes.buffer); // of the page: little-endian, as every computer with a browser is
  }

  // Heights (rows) before the first step and after every one, from the differences that the page holds.
  function surfaces({ heights, shape: [rows, columns], unit }) {
    const steps = numbers(heights);
    const size = rows * columns;
    const now = new Int32Array(size);
    const found = [];
    for (let k = 0; k < steps.length; k += size) {
      for (let n = 0; n < size; n++) now[n] += steps[k + n];
      const heights = Float32Array.from(now, (value) => value * unit);
      found.push(Array.from({ length: rows }, (_, row) => heights.subarray(row * columns, (row + 1) * columns)));
    }
    return found;
  }

  function lines({ paths, unit }) {
    return paths.map(({ points }) =>
      points.map((text) => {
        const flat = numbers(text);
        const line = [[], [], []];
        for (let k = 0; k < flat.length; k++) line[k % 3].push(flat[k] * unit);
        return line;
      }),
    );
  }

  // Plays the steps of a view, which nobody but the reader starts.
  class Player {
    constructor(box, plot, data, steps) {
      Object.assign(this, { plot, data, steps, group: box.querySelector(".view3d-steps") });
      [this.button, this.slider, this.words] = ["button", "input", "output"].map((one) => this.group.querySelector(one));
      this.surfaces = surfaces(steps);
      this.lines = lines(steps);
      this.count = steps.labels.length;
      this.drawn = null;
      this.turn = 0;
      this.playing = false;
      this.slider.max = this.count - 1;
      this.button.addEventListener("click", () => this.toggle());
      this.slider.addEventListener("input", () => this.stop(Number(this.slider.value)));
      this.group.addEventListener("keydown", (event) => {
        if (event.key !== " " || event.target === this.button) return;
        event.preventDefault();
        this.toggle();
      });
    }

    toggle() {
      if (this.playing) this.stop();
      else this.play();
    }

    tell(step) {
      this.slider.value = step;
      this.slider.setAttribute("aria-valuetext", this.steps.labels[step]);
      this.words.textContent = this.steps.labels[step];
      this.words.setAttribute("aria-live", this.playing ? "off" : "polite");
      this.button.textContent = this.playing ? "Pause" : "Play";
    }

    stop(step = Number(this.slider.value)) {
      this.playing = false;
      this.turn++;
      this.tell(step);
      return this.draw(step, 1);
    }

    async play() {
      const turn = ++this.turn;
      const from = Number(this.slider.value);
      let step = from === this.count - 1 ? 0 : from;
      this.playing = true;
      const time = Math.min(Math.max(24000 / this.count, 350), 1500);
      let begun = performance.now();
      this.tell(step);
      while (this.playing && turn === this.turn) {
        if (still.matches) await new Promise((done) => setTimeout(done, 1000));
        const now = await new Promise(requestAnimationFrame);
        if (turn !== this.turn) return;
        const share = still.matches ? 1 : Math.min((now - begun) / time, 1);
        await this.draw(step, share);
        if (share < 1 || turn !== this.turn) continue;
        if (step === this.count - 1) return void this.stop(step);
        this.tell(++step);
        begun = performance.now();
      }
    }

    // The tools have gone along the share (0 to 1) of the path of a step; the sheet is formed at its end.
    async draw(step, share) {
      const sheet = share < 1 ? step : step + 1;
      const change = { x: [], y: [], z: [], of: [] };
      const add = (trace, x, y, z) => {
        for (const [name, value] of Object.entries({ x, y, z, of: trace })) change[name].push(value);
      };
      if (this.drawn?.sheet !== sheet)
        add(this.steps.surface, this.data[this.steps.surface].x, this.data[this.steps.surface].y, this.surfaces[sheet]);
      if (this.drawn?.step !== step) this.steps.paths.forEach(({ trace }, k) => add(trace, ...this.lines[k][step]));
      for (const { trace, path, shape } of this.steps.balls) {
        const line = this.lines[path][step];
        const at = Math.round(share * (line[0].length - 1));
        add(trace, ...shape.map((rows, k) => rows.map((row) => row.map((value) => (at < 0 ? null : value + line[k][at])))));
      }
      this.drawn = { sheet, step };
      const { of, ...values } = change;
      if (of.length) await Plotly.restyle(this.plot, values, of);
    }
  }

  async function show(box) {
    const plot = box.querySelector(".view3d-plot");
    const note = box.querySelector(".view3d-note");
    try {
      await plotly();
      const { data, layout, views } = JSON.parse(await unpacked(box.querySelector("script[data-view3d]")));
      layout.scene.camera = structuredClone(START);
      layout.scene.annotations = Object.values(views)[0].annotations;
      await Plotly.newPlot(plot, data, layout, { responsive: true, displaylogo: false, displayModeBar: false });
      await Plotly.relayout(plot, colours());
      note.remove();
      dark.addEventListener("change", () => Plotly.relayout(plot, colours()));
      const move = (turn, rise, zoom) =>
        Plotly.relayout(plot, { "scene.camera": orbit(plot.layout.scene.camera, turn, rise, zoom) });
      const reset = () => Plotly.relayout(plot, { "scene.camera": structuredClone(START) });
      const step = Math.PI / 24;
      const keys = {
        ArrowLeft: () => move(-step, 0, 1), ArrowRight: () => move(step, 0, 1),
        ArrowUp: () => move(0, step, 1), ArrowDown: () => move(0, -step, 1),
        "+": () => move(0, 0, 0.85), "=": () => move(0, 0, 0.85), "-": () => move(0, 0, 1 / 0.85), Home: reset, 0: reset,
      };
      plot.addEventListener("keydown", (event) => {
        if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        keys[event.key]();
      });
      box.querySelectorAll("button[data-key]").forEach((one) => one.addEventListener("click", keys[one.dataset.key]));
      const players = new Map();
      const player = (name) => {
        if (views[name].steps && !players.has(name)) players.set(name, new Player(box, plot, data, views[name].steps));
        return players.get(name);
      };
      const ratio = structuredClone(layout.scene.aspectratio);
      const choose = async (name) => {
        const { traces, annotations, steps } = views[name];
        for (const one of players.values()) if (one.playing) one.stop();
        const visible = data.map((_, k) => traces.includes(k));
        const change = { "scene.annotations": annotations, "scene.camera": plot.layout.scene.camera };
        change["scene.aspectratio"] = steps ? steps.ratio : ratio;
        ["xaxis", "yaxis", "zaxis"].forEach((axis, k) => {
          if (steps) change[`scene.${axis}.range`] = steps.ranges[k];
          else change[`scene.${axis}.autorange`] = true;
        });
        await Plotly.update(plot, { visible }, change);
        const controls = box.querySelector(".view3d-steps");
        if (controls) controls.hidden = !steps;
        await player(name)?.stop();
      };
      box.querySelectorAll("input[type=radio]").forEach((one) => one.addEventListener("change", () => choose(one.value)));
      if (Object.values(views)[0].steps) await choose(Object.keys(views)[0]);
      let apart = 0;
      const distance = ([a, b]) => Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
      const pinch = (event) => {
        if (event.touches.length !== 2) return void (apart = 0);
        event.preventDefault();
        event.stopPropagation();
        const now = distance(event.touches);
        if (apart && now) move(0, 0, apart / now);
        apart = now;
      };
      for (const name of ["touchstart", "touchmove", "touchend"])
        plot.addEventListener(name, pinch, { capture: true, passive: false });
    } catch (error) {
      note.textContent = `This browser cannot show the part in three dimensions (${error.message}); the pictures below can be seen all the same.`;
    }
  }

  const watcher = new IntersectionObserver(
    (entries) => {
      for (const entry of entries.filter((one) => one.isIntersecting)) {
        watcher.unobserve(entry.target);
        show(entry.target);
      }
    },
    { rootMargin: "200px" },
  );
  document.querySelectorAll(".view3d").forEach((box) => watcher.observe(box));
})();
