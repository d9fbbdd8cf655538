/** A connection to a lane by a socket of Node: frames out, frames in. */

import { statSync } from "node:fs";
import { createConnection, type Socket } from "node:net";

import { ServerLost, TaxelError } from "./errors.js";
import { decodeReply, HEAD_BYTES, replyBytes, type Reply } from "./frames.js";
import type { Connection } from "./source.js";

/**
 * A socket that connects to `unix:PATH` or `tcp:HOST:PORT`. Raises INVALID_ARGUMENT for another address, and
 * PERMISSION_DENIED for another user's file.
 */
function openSocket(address: string): Socket {
  const [, scheme, place = ""] = /^(unix|tcp):(.+)$/.exec(address) ?? [];
  if (scheme === "unix") {
    refuseOthersFile(place);
    return createConnection(place);
  }
  const colon = place.lastIndexOf(":");
  const port = Number(place.slice(colon + 1));
  if (scheme === undefined || colon < 1 || !Number.isInteger(port) || port < 1 || port > 65535)
    throw new TaxelError("INVALID_ARGUMENT", `no lane's address: '${address}'; expected unix:PATH, tcp:HOST:PORT or ws://HOST:PORT/`);
  return createConnection(port, place.slice(0, colon).replace(/^\[(.*)\]$/, "$1")).setNoDelay(true);
}

/** Node does not tell whose the other end is, so the owner of the file stands for it. */
function refuseOthersFile(path: string): void {
  let owner: number;
  try {
    owner = statSync(path).uid;
  } catch {
    return; // Connecting fails for the same reason, and says so.
  }
  if (owner !== 0 && owner !== process.getuid?.())
    throw new TaxelError("PERMISSION_DENIED", `${path} belongs to user ${owner}; a lane is the same user's or root's`);
}

export class LaneConnection implements Connection {
  readonly longest = Infinity;
  private readonly socket: Socket;
  private chunks: Buffer[] = [];
  private held = 0;
  private needed = HEAD_BYTES;
  private lost = false;

  constructor(
    private readonly address: string,
    private readonly onReply: (reply: Reply) => void,
    /** Called once, however the connection ends. */
    private readonly onLost: (error: TaxelError) => void,
  ) {
    this.socket = openSocket(address);
    this.socket.on("data", (chunk: Buffer) => this.take(chunk));
    this.socket.on("error", (error) => this.end(new ServerLost(`${address}: ${error.message}`)));
    this.socket.on("close", () => this.end(new ServerLost(`${address}: the server closed the connection`)));
  }

  /** What is sent before the connection is there waits in the socket. */
  send(frame: Uint8Array): void {
    this.socket.write(frame);
  }

  end(error: TaxelError): void {
    if (this.lost) return;
    this.lost = true;
    this.socket.destroy();
    this.onLost(error);
  }

  /** Pieces are joined only when a head or a frame is whole, so that a long reply is copied twice at most. */
  private take(chunk: Buffer): void {
    this.chunks.push(chunk);
    this.held += chunk.length;
    try {
      while (this.held >= this.needed && !this.lost) this.takeFrame();
    } catch (error) {
      this.end(error instanceof TaxelError ? error : new TaxelError("INTERNAL", `${this.address}: ${String(error)}`));
    }
  }

  private takeFrame(): void {
    let bytes = Buffer.concat(this.chunks);
    this.needed = replyBytes(bytes);
    if (this.held >= this.needed) {
      const reply = decodeReply(bytes.subarray(0, this.needed));
      bytes = bytes.subarray(this.needed);
      this.needed = HEAD_BYTES;
      this.onReply(reply);
    }
    this.chunks = [bytes];
    this.held = bytes.length;
  }
}
