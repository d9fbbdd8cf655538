// Puts the page together: scenes, frames and states come from the stream; everything is drawn here.

import { Charts } from "./charts.js";
import { drawLegend, useStops } from "./colours.js";
import { FingerList } from "./fingers.js";
import { startKeys } from "./keys.js";
import { Past } from "./past.js";
import { showReadings, showStatus } from "./readings.js";
import { SkinMap, cellsOf } from "./skin.js";
import { Stream } from "./stream.js";
import { startTheme, theme } from "./theme.js";
import { Transport } from "./transport.js";

const at = (id) => document.getElementById(id);

class Page {
  constructor() {
    this.scene = null;
    this.pasts = new Map();
    this.electrode = 16;
    this.shown_s = 0;
    this.drawn = [];
    this.worded = 0;
    this.later = null;
    this.list = new FingerList(at("fingers"), (key) => this.pickFinger(key));
    this.stream = new Stream({
      scene: (scene) => this.takeScene(scene),
      frames: (frames) => this.takeFrames(frames),
      status: (status) => this.takeStatus(status),
      lost: () => this.takeStatus({ state: "no connection", rate_hz: null, latency_us: {}, server: {}, note: "taxel watch does not answer; trying again …", viewer: { sent: 0, dropped: 0 } }),
    });
    this.transport = new Transport(this.stream);
    startTheme(at("theme"), () => this.restyle());
    startKeys(this);
  }

  takeScene(scene) {
    this.scene = scene;
    useStops(scene.colours);
    // A live client that comes or goes leaves the others' past; a replay gives the past again.
    const known = scene.kind === "live" ? this.pasts : new Map();
    const fresh = () => new Past(Object.keys(scene.traces), scene.channels.length);
    this.pasts = new Map(scene.fingers.map(({ key }) => [key, known.get(key) ?? fresh()]));
    at("title").textContent = scene.title;
    document.title = `Taxel watch: ${scene.title}`;
    const cells = cellsOf(scene.skin);
    this.views = viewsOf(scene).map((view) => {
      const map = new SkinMap(scene.skin, cells, view.name, (electrode) => this.pickElectrode(electrode));
      const [figure, caption, model] = ["figure", "figcaption", "span"].map((name) => document.createElement(name));
      caption.textContent = view.name;
      model.textContent = view.model && ` ${view.model}`;
      caption.append(model);
      figure.append(caption, map.svg);
      figure.dataset.view = view.name;
      return { ...view, map, figure };
    });
    at("maps").replaceChildren(...this.views.map(({ figure }) => figure));
    at("maps").dataset.maps = this.views.length;
    this.charts = new Charts(at("charts"), scene);
    this.transport.build(scene);
    this.list.build(scene, cells);
    this.restyle();
    this.pickFinger(this.pasts.has(this.finger) ? this.finger : scene.fingers[0]?.key);
    this.pickElectrode(this.electrode);
  }

  takeFrames(frames) {
    for (const frame of frames) {
      this.shown_s = frame.at_s;
      for (const [key, moments] of Object.entries(frame.fingers)) {
        this.pasts.get(key)?.add(moments, frame.restarts, this.scene.history_s);
      }
    }
    const now = performance.now();
    this.drawn = [...this.drawn.filter((time) => now - time < 2000), now];
    this.draw();
  }

  takeStatus(status) {
    const now = performance.now();
    this.drawn = this.drawn.filter((time) => now - time < 2000);
    showStatus(at("status"), status, this.drawn.length / 2);
    at("note").textContent = status.note;
    at("note").hidden = !status.note;
    this.transport.show(status);
  }

  pickFinger(key) {
    this.finger = key;
    this.list.choose(key);
    this.draw();
  }

  pickElectrode(electrode) {
    this.electrode = (electrode + 19) % 19;
    for (const { map } of this.views ?? []) map.pickCell(this.electrode);
    this.draw();
  }

  restyle() {
    if (!this.scene) return;
    drawLegend(at("legend"), this.scene.limit, theme());
    this.charts.style();
    this.draw();
  }

  // Numbers change eight times in a second: nobody reads faster, and text costs more than colours.
  words() {
    const now = performance.now();
    clearTimeout(this.later);
    this.later = null;
    if (now - this.worded < 125) {
      this.later = setTimeout(() => this.draw(), 130);
      return false;
    }
    this.worded = now;
    return true;
  }

  draw() {
    const { scene } = this;
    if (!scene) return;
    const known = scene.fingers.filter(({ key }) => this.pasts.get(key).time.length);
    if (!known.length) return;
    // Asked for here only: the first moment has its numbers at once, and nothing moves under a hand afterwards.
    const words = this.words();
    const trace = Object.keys(scene.traces)[0];
    for (const finger of known) {
      const past = this.pasts.get(finger.key);
      this.list.draw(finger.key, lessRest(past.newest(trace), finger.rest), past.push, scene.limit, theme(), words);
    }
    const finger = scene.fingers.find(({ key }) => key === this.finger);
    const past = this.pasts.get(this.finger);
    if (!past?.time.length) return;
    for (const { map, values, contact } of this.views) {
      map.draw(values(past, finger.rest), scene.limit, theme(), words);
      map.drawContact(past.place, contact ? past.push : null);
    }
    this.charts.draw(past, finger.rest, this.electrode, this.shown_s, words);
    this.transport.at(this.shown_s);
    if (words) showReadings(at("readings"), scene, finger, past);
  }
}

const lessRest = (counts, rest) => counts.slice(2).map((count, i) => (count === null ? null : count - rest[i + 2]));

// What the maps show, in order: each trace, and after a model's trace what it leaves of the measured one.
function viewsOf(scene) {
  const traces = Object.entries(scene.traces);
  const measures = "measured" in scene.traces;
  return traces.flatMap(([trace, model]) => {
    const counts = { name: trace, model, contact: true, values: (past, rest) => lessRest(past.newest(trace), rest) };
    if (!measures || trace === "measured") return [counts];
    const values = (past) => lessRest(past.newest("measured"), past.newest(trace).map((count) => count ?? NaN))
      .map((value) => (Number.isNaN(value) ? null : value));
    const name = trace === "corrected" ? "residual, corrected" : "residual";
    return [counts, { name, model: "measured less " + trace, contact: false, values }];
  });
}

window.page = new Page();
