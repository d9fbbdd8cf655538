// The WebSocket: newest frame only. A frame is drawn with the screen's next refresh and then acknowledged; the
// server sends no more than two that are not acknowledged.

export class Stream {
  constructor(handlers) {
    this.handlers = handlers;
    this.frames = [];
    this.delay = 250;
    this.open();
  }

  open() {
    const place = location.href.replace(/^http/, "ws").replace(/[^/]*$/, "stream");
    this.socket = new WebSocket(place);
    this.socket.onopen = () => { this.delay = 250; };
    this.socket.onmessage = (event) => this.take(JSON.parse(event.data));
    this.socket.onclose = () => {
      this.frames = [];
      this.handlers.lost();
      setTimeout(() => this.open(), this.delay);
      this.delay = Math.min(2 * this.delay, 4000);
    };
  }

  take(message) {
    if (message.type !== "frame") {
      this.handlers[message.type]?.(message);
      return;
    }
    this.frames.push(message);
    if (this.frames.length === 1) requestAnimationFrame(() => this.draw());
  }

  draw() {
    const frames = this.frames.splice(0);
    if (!frames.length) return;
    this.handlers.frames(frames);
    for (const frame of frames) this.say("drawn", frame.number);
  }

  say(name, value = 0) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ name, value }));
  }
}
