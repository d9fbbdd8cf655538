// The last seconds of one fingertip, in columns.

export class Past {
  constructor(traces, channels) {
    this.time = [];
    this.force = [[], [], []];
    this.counts = Object.fromEntries(traces.map((trace) => [trace, Array.from({ length: channels }, () => [])]));
    this.place = null;
    this.push = null;
  }

  columns() {
    return [this.time, ...this.force, ...Object.values(this.counts).flat()];
  }

  add(moments, restarts, seconds) {
    if (restarts) for (const column of this.columns()) column.length = 0;
    for (let row = 0; row < moments.time_s.length; row++) {
      this.time.push(moments.time_s[row]);
      this.force.forEach((column, axis) => column.push(moments.force_n[row][axis]));
      for (const [trace, columns] of Object.entries(this.counts)) {
        const counts = moments.counts[trace]?.[row];
        columns.forEach((column, channel) => column.push(counts ? counts[channel] : null));
      }
    }
    this.place = moments.place_mm;
    this.push = moments.push_n;
    const oldest = this.time[this.time.length - 1] - seconds;
    const old = this.time.findIndex((time) => time >= oldest);
    if (old > 200) for (const column of this.columns()) column.splice(0, old);
  }

  // (21,) the newest counts of a trace, null where there are none.
  newest(trace) {
    return this.counts[trace].map((column) => column.at(-1) ?? null);
  }
}
