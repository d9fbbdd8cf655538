/** A connection to a lane by the browser's own WebSocket: each message is a frame. */

import { ServerLost, TaxelError } from "./errors.js";
import { decodeReply, HEAD_BYTES, replyBytes, type Reply } from "./frames.js";
import type { Connection } from "./source.js";

export class WebSocketConnection implements Connection {
  readonly longest = 2 ** 20;
  private readonly socket: WebSocket;
  private waiting: Uint8Array<ArrayBuffer>[] = [];
  private lost = false;

  /** `address` is `ws://HOST:PORT/`. Raises INVALID_ARGUMENT for what no WebSocket can open. */
  constructor(
    private readonly address: string,
    private readonly onReply: (reply: Reply) => void,
    private readonly onLost: (error: TaxelError) => void,
  ) {
    if (typeof WebSocket === "undefined")
      throw new TaxelError("INVALID_ARGUMENT", `${address}: there is no WebSocket here; Node has one from version 22 on`);
    try {
      this.socket = new WebSocket(address);
    } catch (error) {
      throw new TaxelError("INVALID_ARGUMENT", `${address}: ${String(error)}; expected ws://HOST:PORT/`);
    }
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      for (const frame of this.waiting.splice(0)) this.socket.send(frame);
    };
    this.socket.onmessage = ({ data }: MessageEvent<unknown>) => this.take(data);
    // A browser does not tell a page why.
    this.socket.onerror = () =>
      this.end(new ServerLost(`${address}: the connection failed; nobody listens there, or this page may not come`));
    this.socket.onclose = ({ code, reason }) =>
      this.end(new ServerLost(`${address}: the connection ended (${code}${reason === "" ? "" : `, ${reason}`})`));
  }

  send(frame: Uint8Array<ArrayBuffer>): void {
    if (this.socket.readyState === WebSocket.CONNECTING) this.waiting.push(frame);
    else this.socket.send(frame);
  }

  end(error: TaxelError): void {
    if (this.lost) return;
    this.lost = true;
    this.socket.close();
    this.onLost(error);
  }

  private take(data: unknown): void {
    if (this.lost) return;
    try {
      const frame = data instanceof ArrayBuffer ? new Uint8Array(data) : new Uint8Array();
      if (frame.length < HEAD_BYTES || replyBytes(frame) !== frame.length)
        throw new TaxelError("INTERNAL", `${this.address}: a message is no reply of the lane`);
      this.onReply(decodeReply(frame));
    } catch (error) {
      this.end(error instanceof TaxelError ? error : new TaxelError("INTERNAL", `${this.address}: ${String(error)}`));
    }
  }
}
