// The map of the unrolled skin: a cell for each electrode, and the contact with its force.

import { colourOf, css, inkOn, signed } from "./colours.js";

const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes = {}, parent = null) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

const points = (polygon) => polygon.map(([x, y]) => `${x.toFixed(3)},${(-y).toFixed(3)}`).join(" ");

// The part of a polygon that is nearer to `own` than to `other` (Sutherland and Hodgman's clipping).
function nearer(polygon, own, other) {
  const side = ([x, y]) =>
    (other[0] - own[0]) * (x - (own[0] + other[0]) / 2) + (other[1] - own[1]) * (y - (own[1] + other[1]) / 2);
  const kept = [];
  polygon.forEach((to, i) => {
    const from = polygon.at(i - 1);
    const [before, after] = [side(from), side(to)];
    if (before * after < 0) {
      const part = before / (before - after);
      kept.push([from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1])]);
    }
    if (after <= 0) kept.push(to);
  });
  return kept;
}

export const cellsOf = (skin) => skin.electrodes_mm.map((own, i) =>
  skin.electrodes_mm.reduce((cell, other, j) => (i === j ? cell : nearer(cell, own, other)), skin.outline_mm));

function viewBox(skin, margin) {
  const [xs, ys] = [0, 1].map((axis) => skin.outline_mm.map((place) => place[axis]));
  const [left, right] = [Math.min(...xs) - margin, Math.max(...xs) + margin];
  const [low, high] = [Math.min(...ys) - margin, Math.max(...ys) + margin];
  return `${left} ${-high} ${right - left} ${high - low}`;
}

export class SkinMap {
  // `pick` is told the electrode that was chosen; without it the map is a small picture.
  constructor(skin, cells, label, pick = null) {
    this.svg = element("svg", { class: "map", viewBox: viewBox(skin, 0.4), role: pick ? "group" : "img", "aria-label": label });
    this.small = !pick;
    element("title", {}, this.svg).textContent = `${label}: the skin seen from outside, unrolled, the tip up`;
    this.cells = cells.map((cell, i) => {
      const group = element("g", { "data-channel": `e${i + 1}` }, this.svg);
      const shape = element("polygon", { class: "cell", points: points(cell) }, group);
      if (!pick) return { shape };
      group.setAttribute("tabindex", "0");
      group.setAttribute("role", "button");
      group.setAttribute("aria-label", `electrode ${i + 1}`);
      group.addEventListener("click", () => pick(i));
      group.addEventListener("keydown", (event) => {
        if (event.key === "Enter") pick(i);
      });
      const [x, y] = skin.electrodes_mm[i];
      const name = element("text", { x, y: -y - 0.15 }, group);
      name.textContent = `e${i + 1}`;
      const value = element("text", { class: "value", x, y: -y + 1.15 }, group);
      return { shape, group, name, value };
    });
    element("polygon", { class: "edge", points: points(skin.outline_mm) }, this.svg);
    this.picked = element("polygon", { class: "picked", visibility: "hidden" }, this.svg);
    this.contact = element("g", { class: "contact", visibility: "hidden" }, this.svg);
    this.rings = ["halo", "line"].map((name) => element("circle", { class: name }, this.contact));
    this.arrows = ["halo", "line"].map((name) => element("path", { class: name }, this.contact));
    this.outlines = cells;
  }

  pickCell(electrode) {
    this.picked.setAttribute("visibility", "visible");
    this.picked.setAttribute("points", points(this.outlines[electrode]));
    this.cells.forEach(({ group }, i) => group.setAttribute("aria-pressed", i === electrode));
  }

  // `values`: 19 counts less rest, null where there is none; numbers are written where `words` says so.
  draw(values, limit, theme, words = true) {
    this.cells.forEach(({ shape, name, value }, i) => {
      const known = values[i] !== null;
      const colour = colourOf(known ? values[i] : 0, limit, theme);
      shape.style.fill = known ? css(colour) : "none";
      if (this.small || !words) return;
      const ink = known ? inkOn(colour) : "var(--quiet)";
      name.style.fill = value.style.fill = ink;
      value.textContent = known ? signed(values[i]) : "–";
    });
  }

  // A ring where the finger is touched, larger with the force into the skin; an arrow along the force beside it.
  drawContact(place, push) {
    const force = push ? Math.hypot(...push) : 0;
    this.contact.setAttribute("visibility", force >= 0.05 ? "visible" : "hidden");
    if (force < 0.05) return;
    const [x, y] = [place[0], -place[1]];
    const radius = 0.5 + 1.1 * Math.sqrt(Math.max(push[0], 0));
    for (const ring of this.rings) {
      ring.setAttribute("cx", x);
      ring.setAttribute("cy", y);
      ring.setAttribute("r", radius);
    }
    const [across, along] = [2.5 * push[1], -2.5 * push[2]];
    const length = Math.hypot(across, along);
    const [ux, uy] = length ? [across / length, along / length] : [0, 0];
    const [tipX, tipY] = [x + across, y + along];
    const head = Math.min(0.9, length / 2);
    const barb = (turn) => `${tipX - head * (ux + turn * uy * 0.6)} ${tipY - head * (uy - turn * ux * 0.6)}`;
    const arrow = length < 0.4 ? "" : `M${x} ${y}L${tipX} ${tipY}M${barb(1)}L${tipX} ${tipY}L${barb(-1)}`;
    for (const path of this.arrows) path.setAttribute("d", arrow);
  }
}
