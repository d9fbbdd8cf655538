// Small pictures of all fingertips, to choose one.

import { SkinMap } from "./skin.js";

export class FingerList {
  constructor(nav, pick) {
    [this.nav, this.pick] = [nav, pick];
    this.items = new Map();
  }

  build(scene, cells) {
    this.items.clear();
    this.nav.replaceChildren();
    this.nav.hidden = scene.fingers.length < 2;
    const hands = new Map();
    for (const finger of scene.fingers) {
      if (!hands.has(finger.hand)) hands.set(finger.hand, this.hand(finger.hand));
      const map = new SkinMap(scene.skin, cells, finger.label);
      const button = document.createElement("button");
      const words = document.createElement("div");
      const [name, force] = [document.createElement("b"), document.createElement("span")];
      name.textContent = finger.label;
      force.textContent = "–";
      words.append(name, force);
      button.append(map.svg, words);
      button.addEventListener("click", () => this.pick(finger.key));
      hands.get(finger.hand).append(button);
      this.items.set(finger.key, { map, button, force });
    }
  }

  hand(name) {
    const group = document.createElement("fieldset");
    const [legend, row] = [document.createElement("legend"), document.createElement("div")];
    legend.textContent = name;
    row.className = "hand";
    group.append(legend, row);
    this.nav.append(group);
    return row;
  }

  choose(key) {
    for (const [own, { button }] of this.items) button.setAttribute("aria-pressed", own === key);
  }

  draw(key, values, push, limit, theme, words) {
    const item = this.items.get(key);
    if (!item || this.nav.hidden) return;
    item.map.draw(values, limit, theme);
    if (words) item.force.textContent = `${Math.hypot(...push).toFixed(1)} N`;
  }
}
