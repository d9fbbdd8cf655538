// Numbers: what the fingertip reads now, and the state of the source.

import { signed } from "./colours.js";

const entry = (name, value, small = "", kind = "") => {
  const box = document.createElement("div");
  const [term, told] = [document.createElement("dt"), document.createElement("dd")];
  term.textContent = name;
  told.textContent = value;
  told.className = kind;
  if (small) {
    const more = document.createElement("small");
    more.textContent = ` ${small}`;
    told.append(more);
  }
  box.append(term, told);
  return box;
};

const pressure = (counts, each) => {
  const pascals = counts * each;
  return Math.abs(pascals) >= 1000 ? `${signed(pascals / 1000, 1)} kPa` : `${signed(pascals)} Pa`;
};

// Root of the mean square of what a model gets wrong on the 19 electrodes.
function residualOf(past, trace) {
  const [measured, other] = [past.newest("measured"), past.newest(trace)];
  if (other[2] === null) return null;
  const squares = measured.slice(2).map((count, i) => (count - other[i + 2]) ** 2);
  return Math.sqrt(squares.reduce((sum, square) => sum + square, 0) / squares.length);
}

export function showReadings(place, scene, finger, past) {
  const trace = Object.keys(scene.traces)[0];
  const now = past.newest(trace).map((count, i) => (count === null ? null : count - finger.rest[i]));
  const force = past.force.map((column) => column.at(-1) ?? 0);
  const each = scene.pascals_a_count;
  const entries = [
    entry("force", `${Math.hypot(...force).toFixed(2)} N`),
    entry("into the skin", `${signed(past.push?.[0] ?? 0, 2)} N`),
    entry("along the skin", `${Math.hypot(past.push?.[1] ?? 0, past.push?.[2] ?? 0).toFixed(2)} N`),
    now[1] === null ? entry("pressure pdc", "–") : entry("pressure pdc", signed(now[1]), pressure(now[1], each.pdc)),
    now[0] === null ? entry("vibration pac0", "–") : entry("vibration pac0", signed(now[0]), pressure(now[0], each.pac0)),
  ];
  for (const model of Object.keys(scene.traces).filter((name) => name !== "measured")) {
    if (trace !== "measured") continue;
    const residual = residualOf(past, model);
    entries.push(entry(model === "corrected" ? "residual, corrected" : "residual", residual === null ? "–" : residual.toFixed(0), "RMS of e1 … e19"));
  }
  place.replaceChildren(...entries);
}

const GOOD = new Set(["playing", "live", "paused"]);

export function showStatus(place, status, framesDrawn) {
  const { p50, p99 } = status.latency_us;
  const microseconds = (value) => (value >= 1000 ? `${(value / 1000).toFixed(1)} ms` : `${value.toFixed(0)} µs`);
  const entries = [entry("", status.state, "", `state ${GOOD.has(status.state) ? "good" : ""}`)];
  if (status.rate_hz !== null) entries.push(entry("rate", `${status.rate_hz.toFixed(0)} Hz`));
  if (p50 !== undefined) {
    const box = entry("latency", `${microseconds(p50)}`, `p99 ${microseconds(p99)}`);
    box.title = status.latency_of;
    entries.push(box);
  }
  for (const [name, value] of Object.entries(status.server)) entries.push(entry(name, value));
  const drawn = entry("drawn", `${framesDrawn.toFixed(0)} frames/s`);
  drawn.title = `${status.viewer.sent} frames sent, ${status.viewer.dropped} dropped because this page was busy`;
  if (status.state !== "paused") entries.push(drawn);
  place.replaceChildren(...entries);
}
