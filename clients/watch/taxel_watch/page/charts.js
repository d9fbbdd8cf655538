// Strip charts of the last seconds.

import uPlot from "./vendor/uPlot.esm.js";
import { signed } from "./colours.js";

const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

class Chart {
  constructor(parent, title, unit, least) {
    this.box = document.createElement("div");
    this.box.className = "chart";
    this.box.innerHTML = `<h2><span class="name"></span></h2><div class="plot"></div>`;
    this.head = this.box.querySelector("h2");
    this.place = this.box.querySelector(".plot");
    parent.append(this.box);
    [this.title, this.unit, this.least] = [title, unit, least];
  }

  // `lines`: [label, colour's name, dash] of each series.
  build(lines) {
    this.lines = lines;
    this.plot?.destroy();
    const axis = { stroke: variable("quiet"), grid: { stroke: variable("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    this.plot = new uPlot({
      width: Math.max(this.place.clientWidth, 50),
      height: Math.max(this.place.clientHeight, 50),
      legend: { show: false },
      cursor: { show: false },
      padding: [6, 8, 0, 0],
      scales: {
        x: { time: false, range: () => this.range ?? [0, 1] },
        y: { range: (_, low, high) => this.reach(low, high) },
      },
      axes: [
        { ...axis, size: 20, values: (_, ticks) => ticks.map((tick) => (tick < 0 ? "" : `${tick} s`)) },
        { ...axis, size: 46, values: (_, ticks) => ticks.map((tick) => String(tick).replace("-", "−")) },
      ],
      series: [{}, ...lines.map(([label, colour, dash]) => ({
        label, stroke: variable(colour), width: 1.5, dash, points: { show: false }, spanGaps: false,
      }))],
    }, [[], ...lines.map(() => [])], this.place);
    this.keys = lines.map(([label, colour, dash]) => {
      const key = document.createElement("span");
      key.className = "key";
      const style = dash ? (dash[0] > 2 ? "dashed" : "dotted") : "solid";
      key.innerHTML = `<i style="border-top-style: ${style}; border-color: var(--${colour})"></i><span></span>`;
      return [label, key, key.lastChild];
    });
    this.head.replaceChildren(this.head.firstChild, ...this.keys.map(([, key]) => key));
    this.name(this.title);
  }

  name(title) {
    this.title = title;
    this.head.firstChild.textContent = `${title}, ${this.unit}`;
  }

  reach(low, high) {
    const [from, to] = [Math.min(low ?? 0, -this.least), Math.max(high ?? 0, this.least)];
    const margin = 0.06 * (to - from);
    return [from - margin, to + margin];
  }

  draw(range, columns, digits, words) {
    this.range = range;
    this.plot.setData(columns);
    if (!words) return;
    this.keys.forEach(([label, , text], i) => {
      const value = columns[i + 1].at(-1);
      text.textContent = `${label} ${value == null ? "–" : signed(value, digits)}`;
    });
  }

  fit() {
    const [width, height] = [this.place.clientWidth, this.place.clientHeight];
    if (this.plot && width && height) this.plot.setSize({ width, height });
  }
}

const less = (column, rest) => column.map((count) => (count === null ? null : count - rest));

export class Charts {
  constructor(parent, scene) {
    parent.replaceChildren();
    this.scene = scene;
    this.traces = Object.keys(scene.traces);
    this.models = this.traces.filter((trace) => trace !== "measured");
    this.compares = this.traces.includes("measured") && this.models.length > 0;
    this.force = new Chart(parent, "force on the finger", "N", 1);
    this.pdc = new Chart(parent, "pressure pdc", "counts less rest", 50);
    this.pac0 = new Chart(parent, "vibration pac0", "counts less rest", 50);
    this.electrode = new Chart(parent, "", "counts less rest", 50);
    this.residual = this.compares ? new Chart(parent, "", "counts", 20) : null;
    this.all = [this.force, this.pdc, this.pac0, this.electrode, this.residual].filter(Boolean);
    this.style();
    new ResizeObserver(() => this.all.forEach((chart) => chart.fit())).observe(parent);
  }

  // Again after the theme has changed: a canvas knows no CSS.
  style() {
    this.force.build([["x", "fx"], ["y", "fy", [6, 3]], ["z", "fz", [2, 2]]]);
    const dashes = { measured: undefined, predicted: [6, 3], corrected: [2, 2] };
    const lines = (traces) => traces.map((trace) => [trace, trace, dashes[trace]]);
    for (const chart of [this.pdc, this.pac0, this.electrode]) chart.build(lines(this.traces));
    this.residual?.build(lines(this.models));
  }

  draw(past, rest, electrode, at, words) {
    const range = [at - this.scene.history_s, at];
    const { time, counts } = past;
    const channel = 2 + electrode;
    const lines = (place) => [time, ...this.traces.map((trace) => less(counts[trace][place], rest[place]))];
    this.force.draw(range, [time, ...past.force], 2, words);
    this.pac0.draw(range, lines(0), 0, words);
    this.pdc.draw(range, lines(1), 0, words);
    if (words) this.electrode.name(`electrode e${electrode + 1}`);
    this.electrode.draw(range, lines(channel), 0, words);
    if (!this.residual) return;
    if (words) this.residual.name(`residual of e${electrode + 1}: measured less predicted`);
    const measured = counts.measured[channel];
    const residuals = this.models.map((trace) =>
      counts[trace][channel].map((count, i) => (count === null ? null : measured[i] - count)));
    this.residual.draw(range, [time, ...residuals], 0, words);
  }
}
