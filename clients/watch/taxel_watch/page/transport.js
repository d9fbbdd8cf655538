// Play, pause and seek in a recording.

const clock = (seconds) => {
  const whole = Math.floor(seconds / 60);
  return `${whole}:${(seconds - 60 * whole).toFixed(1).padStart(4, "0")}`;
};

export class Transport {
  constructor(stream) {
    this.stream = stream;
    for (const name of ["transport", "play", "clock", "seek", "speed", "overview"]) this[name] = document.getElementById(name);
    this.playing = true;
    this.held = false;
    this.play.addEventListener("click", () => this.toggle());
    this.seek.addEventListener("input", () => this.to(Number(this.seek.value)));
    this.seek.addEventListener("pointerdown", () => { this.held = true; });
    this.seek.addEventListener("pointerup", () => { this.held = false; });
    this.speed.addEventListener("change", () => stream.say("speed", Number(this.speed.value)));
  }

  build(scene) {
    this.duration = scene.duration_s;
    this.transport.hidden = scene.duration_s === null;
    if (scene.duration_s === null) return;
    this.seek.max = scene.duration_s;
    const forces = scene.overview_n;
    const most = Math.max(...forces, 0.1);
    this.overview.setAttribute("viewBox", `0 0 ${forces.length} 1`);
    const steps = forces.map((force, i) => `L${i} ${1 - force / most}L${i + 1} ${1 - force / most}`).join("");
    this.overview.innerHTML = `<path d="M0 1${steps}L${forces.length} 1z"/>`;
  }

  show(status) {
    this.playing = status.state === "playing";
    this.play.textContent = this.playing ? "❚❚" : "▶";
    this.play.setAttribute("aria-pressed", this.playing);
  }

  at(seconds) {
    if (this.transport.hidden) return;
    this.clock.textContent = `${clock(seconds)} / ${clock(this.duration)}`;
    if (!this.held) this.seek.value = seconds;
    this.seek.setAttribute("aria-valuetext", `${seconds.toFixed(1)} s`);
  }

  toggle() {
    this.playing = !this.playing;
    this.stream.say(this.playing ? "play" : "pause");
    this.show({ state: this.playing ? "playing" : "paused" });
  }

  step(samples) {
    this.stream.say("step", samples);
    this.show({ state: "paused" });
  }

  to(seconds) {
    this.stream.say("seek", seconds);
  }
}
