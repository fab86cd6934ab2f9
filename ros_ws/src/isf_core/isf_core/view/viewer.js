// Unpacks figures of plotly when they come into sight, and adds what plotly lacks: keys, pinch, buttons, light and dark.
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
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
      box.querySelectorAll("input[type=radio]").forEach((one) =>
        one.addEventListener("change", () => {
          const { traces, annotations } = views[one.value];
          const visible = data.map((_, k) => traces.includes(k));
          Plotly.update(plot, { visible }, { "scene.annotations": annotations, "scene.camera": plot.layout.scene.camera });
        }),
      );
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
