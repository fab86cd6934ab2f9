// Plots over time and over contours.
import { uPlot } from "./libraries.js";

const HEIGHT = 210;

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

// A plot in `box` of `series` ({label, colour: a variable of the style, unit, ...}); drawn anew when the scheme changes.
export class Plot {
  constructor(box, axes, series) {
    this.box = box;
    this.axes = axes;
    this.series = series;
    this.data = [[], ...series.map(() => [])];
    this.make();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.make());
    new ResizeObserver(() => this.plot.setSize(this.extent())).observe(box);
  }

  extent() {
    return { width: Math.max(200, this.box.clientWidth), height: HEIGHT };
  }

  make() {
    this.plot?.destroy();
    const [ink, edge] = [css("--soft"), css("--edge")];
    const axis = { stroke: ink, grid: { stroke: edge, width: 1 }, ticks: { stroke: edge, width: 1 }, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 18 };
    this.plot = new uPlot({
      ...this.extent(),
      scales: { x: { time: false }, y: { range: this.axes.range } },
      axes: [{ ...axis, label: this.axes.x, size: 32, incrs: this.axes.incrs }, { ...axis, label: this.axes.y, size: 48 }],
      cursor: { drag: { x: false, y: false } },
      legend: { live: false },
      series: [{}, ...this.series.map(({ colour, ...rest }) => ({ stroke: css(colour), width: 1.5, points: { show: false }, ...rest }))],
    }, this.data, this.box);
  }

  show(data) {
    this.data = data;
    this.plot.setData(data);
  }
}
