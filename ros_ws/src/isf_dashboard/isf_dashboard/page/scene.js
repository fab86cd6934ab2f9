// The part, its paths and the tools in three dimensions; lengths in mm, frame "sheet", z up.
import {
  AmbientLight, BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide, Group,
  LineBasicMaterial, LineSegments, Mesh, MeshLambertMaterial, OrbitControls, PerspectiveCamera, Scene, SphereGeometry,
  WebGLRenderer,
} from "./libraries.js";

// ColorBrewer RdBu as in the report, and viridis: both are told apart by colour-blind people.
const MAPS = {
  deviation: [[0, 0x053061], [0.2, 0x2f79b5], [0.35, 0x92c5de], [0.5, 0xe6e9eb], [0.65, 0xf4a582], [0.8, 0xd6604d], [1, 0x67001f]],
  sequence: [[0, 0x440154], [0.25, 0x3b528b], [0.5, 0x21918c], [0.75, 0x5ec962], [1, 0xfde725]],
};

export function colourOf(map, share) {
  const stops = MAPS[map];
  const at = Math.min(1, Math.max(0, share));
  let k = 1;
  while (k < stops.length - 1 && stops[k][0] < at) k += 1;
  const [low, from] = stops[k - 1];
  const [high, to] = stops[k];
  const part = (at - low) / (high - low);
  return [16, 8, 0].map((shift) => {
    const a = (from >> shift) & 255;
    return (a + part * (((to >> shift) & 255) - a)) / 255;
  });
}

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

export class PartScene {
  // Throws where the browser has no WebGL.
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: true });
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(35, 1, 1, 10000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => { this.dirty = true; });
    this.scene.add(new AmbientLight(0xffffff, 1.9));
    const sun = new DirectionalLight(0xffffff, 1.6);
    sun.position.set(-1, -0.6, 2);
    this.scene.add(sun);
    this.lines = {};
    this.tools = [this.tool(0x0072b2, 1), this.tool(0xe69f00, -1)];
    this.size = 100;
    this.middle = [0, 0, 0];
    this.home();
    this.themed();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.themed());
    new ResizeObserver(() => this.resized()).observe(canvas.parentElement);
    canvas.addEventListener("keydown", (event) => this.key(event));
    this.resized();
  }

  themed() {
    this.renderer.setClearColor(new Color(css("--scene")));
    this.plain = new Color(css("--sheet")).toArray();
    const colours = { planned: css("--soft"), formed: css("--ink"), current: css("--orange") };
    for (const [name, line] of Object.entries(this.lines)) line.material.color.set(colours[name]);
    this.lineColours = colours;
    this.dirty = true;
    this.onTheme?.();
  }

  home() {
    const [x, y, z] = this.middle;
    this.controls.target.set(x, y, z);
    this.camera.position.set(x + 0.75 * this.size, y - 1.15 * this.size, z + 0.95 * this.size);
    this.controls.update();
    this.dirty = true;
  }

  resized() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

  key(event) {
    const turns = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    const zooms = { "+": 0.9, "=": 0.9, "-": 1.1 };
    const away = this.camera.position.clone().sub(this.controls.target);
    if (event.key in turns) {
      const [around, up] = turns[event.key];
      const flat = Math.hypot(away.x, away.y);
      const angle = Math.atan2(away.y, away.x) - around;
      const height = Math.min(1.5, Math.max(-1.5, Math.atan2(away.z, flat) + up));
      const length = away.length();
      away.set(length * Math.cos(height) * Math.cos(angle), length * Math.cos(height) * Math.sin(angle), length * Math.sin(height));
    } else if (event.key in zooms) {
      away.multiplyScalar(zooms[event.key]);
    } else if (event.key === "Home") {
      event.preventDefault();
      this.home();
      return;
    } else {
      return;
    }
    event.preventDefault();
    this.camera.position.copy(this.controls.target).add(away);
    this.controls.update();
    this.dirty = true;
  }

  tool(colour, up) {
    const group = new Group();
    const skin = new MeshLambertMaterial({ color: colour });
    const ball = new Mesh(new SphereGeometry(1, 24, 16), skin);
    const shank = new Mesh(new CylinderGeometry(0.8, 0.8, 4, 20), skin);
    ball.position.z = up;
    shank.rotation.x = Math.PI / 2;
    shank.position.z = 3 * up;
    group.add(ball, shank);
    group.rotation.order = "ZYX";
    group.visible = false;
    this.scene.add(group);
    return group;
  }

  // Radii in mm of the balls of both tools.
  radii(values) {
    this.tools.forEach((tool, k) => tool.scale.setScalar(values[k] || 5));
    this.dirty = true;
  }

  // tip: [x, y, z] mm, or null; angles: about x, y, z in degrees.
  place(number, tip, angles) {
    const tool = this.tools[number];
    tool.visible = tip !== null;
    if (tip !== null) {
      tool.position.set(...tip);
      tool.rotation.set(...angles.map((angle) => (angle || 0) * Math.PI / 180), "ZYX");
    }
    this.dirty = true;
  }

  // Grid of the sheet: x (nx), y (ny), z (ny * nx) mm, not a number where there is none; the view is of its openings.
  grid(x, y, z, opening) {
    if (this.sheet) {
      this.scene.remove(this.sheet);
      this.sheet.geometry.dispose();
    }
    const [nx, ny] = [x.length, y.length];
    const places = new Float32Array(3 * nx * ny);
    for (let row = 0; row < ny; row += 1) {
      for (let column = 0; column < nx; column += 1) {
        const k = row * nx + column;
        places.set([x[column], y[row], Number.isNaN(z[k]) ? 0 : z[k]], 3 * k);
      }
    }
    const faces = [];
    for (let row = 0; row + 1 < ny; row += 1) {
      for (let column = 0; column + 1 < nx; column += 1) {
        const k = row * nx + column;
        const corners = [k, k + 1, k + nx, k + nx + 1];
        if (corners.some((corner) => Number.isNaN(z[corner]))) continue;
        faces.push(k, k + 1, k + nx + 1, k, k + nx + 1, k + nx);
      }
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(places, 3));
    geometry.setAttribute("color", new BufferAttribute(new Float32Array(3 * nx * ny).fill(0.7), 3));
    geometry.setIndex(faces);
    this.sheet = new Mesh(geometry, new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }));
    this.scene.add(this.sheet);
    const box = { x: [Infinity, -Infinity], y: [Infinity, -Infinity], z: [0, 0] };
    const widen = (axis, value) => { box[axis] = [Math.min(box[axis][0], value), Math.max(box[axis][1], value)]; };
    for (let k = 0; k < z.length; k += 1) {
      if (!opening[k] || Number.isNaN(z[k])) continue;
      widen("x", x[k % nx]);
      widen("y", y[Math.floor(k / nx)]);
      widen("z", z[k]);
    }
    this.size = 1.35 * Math.max(box.x[1] - box.x[0], box.y[1] - box.y[0], 10);
    this.middle = ["x", "y", "z"].map((axis) => (box[axis][0] + box[axis][1]) / 2);
    this.home();
  }

  // z (ny * nx) mm; share (ny * nx) of the map, not a number: plain.
  surface(z, share, map) {
    const places = this.sheet.geometry.getAttribute("position");
    const colours = this.sheet.geometry.getAttribute("color");
    const colour = new Color();
    for (let k = 0; k < z.length; k += 1) {
      if (!Number.isNaN(z[k])) places.array[3 * k + 2] = z[k];
      if (Number.isNaN(share[k])) {
        colours.array.set(this.plain, 3 * k);
      } else {
        colour.setRGB(...colourOf(map, share[k]), "srgb");
        colour.toArray(colours.array, 3 * k);
      }
    }
    places.needsUpdate = true;
    colours.needsUpdate = true;
    this.sheet.geometry.computeVertexNormals();
    this.dirty = true;
  }

  // Lines through every path of `paths` ([x, y, z, x, ...] mm each) as one of planned, formed, current.
  path(name, paths, lift) {
    let count = 0;
    for (const one of paths) count += Math.max(0, one.length / 3 - 1);
    const places = new Float32Array(6 * count);
    let at = 0;
    for (const one of paths) {
      for (let k = 0; k + 5 < one.length; k += 3) {
        places.set(one.subarray(k, k + 6), at);
        places[at + 2] += lift;
        places[at + 5] += lift;
        at += 6;
      }
    }
    if (this.lines[name]) {
      this.scene.remove(this.lines[name]);
      this.lines[name].geometry.dispose();
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(places, 3));
    const faint = name === "planned" ? 0.35 : name === "formed" ? 0.55 : 1;
    const material = new LineBasicMaterial({ color: this.lineColours[name], transparent: faint < 1, opacity: faint });
    this.lines[name] = new LineSegments(geometry, material);
    this.lines[name].frustumCulled = false;
    this.scene.add(this.lines[name]);
    this.dirty = true;
  }

  draw() {
    if (!this.dirty) return;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
  }
}
