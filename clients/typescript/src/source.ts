/** The client, in a browser as in Node: asks a server's lane for predictions. */

import { ServerLost, TaxelError } from "./errors.js";
import { encodeRequest, type Predictions, type Reply } from "./frames.js";

const LARGEST_TIMEOUT_MS = 2 ** 31 - 1; // the most that a timer holds
const LARGEST_ID = 2 ** 32 - 1;

export interface SourceOptions {
  /** How long a request may take, connecting included, in milliseconds. Default 5000. */
  readonly timeoutMs?: number;
}

export interface InferOptions {
  /** Without one, the newest version that is loaded. */
  readonly version?: string;
  /** Asks an ensemble for its spread, too. */
  readonly spread?: boolean;
  /** For this request, in milliseconds; else the source's. */
  readonly timeoutMs?: number;
}

/** What carries frames. It is given up when it ends; the next request opens another one. */
export interface Connection {
  /** The most bytes of a frame. */
  readonly longest: number;
  /** What is sent before the connection is there waits. */
  send(frame: Uint8Array<ArrayBuffer>): void;
  end(error: TaxelError): void;
}

/** Opens a connection to an address. `onLost` is called once, however it ends. */
export type Opening = (
  address: string,
  onReply: (reply: Reply) => void,
  onLost: (error: TaxelError) => void,
) => Connection;

interface InFlight {
  readonly resolve: (predictions: Predictions) => void;
  readonly reject: (error: TaxelError) => void;
  readonly timer: ReturnType<typeof setTimeout>;
  readonly rows: number;
}

/**
 * A server at an address that `open` understands.
 *
 * It connects at the first request, and again at the first after a connection was lost. Any number of requests may be in
 * flight. An open connection keeps the process alive; `close` ends it.
 */
export class SourceBy {
  private connection: Connection | undefined;
  private readonly inFlight = new Map<number, InFlight>();
  private lastId = 0;
  private closed = false;
  private readonly timeoutMs: number;

  constructor(
    private readonly open: Opening,
    readonly address: string,
    options: SourceOptions = {},
  ) {
    this.timeoutMs = checkedTimeout(options.timeoutMs ?? 5000);
  }

  /** Predictions for n windows of f numbers each. Every error is a TaxelError. */
  async infer(model: string, windows: readonly ArrayLike<number>[], options: InferOptions = {}): Promise<Predictions> {
    if (this.closed) throw new TaxelError("UNAVAILABLE", "the source was closed");
    const timeoutMs = checkedTimeout(options.timeoutMs ?? this.timeoutMs);
    const version = options.version === undefined ? "" : `/versions/${options.version}`;
    const path = `v2/models/${model}${version}/infer`;
    const id = this.nextId();
    const frame = encodeRequest({ id, path, windows, spread: options.spread ?? false, timeoutMs });
    const connection = this.connected();
    if (frame.length > connection.longest)
      throw new TaxelError(
        "RESOURCE_EXHAUSTED",
        `the request has ${frame.length} bytes; at most ${connection.longest} are taken here`,
      );
    return new Promise((resolve, reject) => {
      const late = (): void => this.finish(id, new TaxelError("DEADLINE_EXCEEDED", `no answer within ${timeoutMs} ms`));
      this.inFlight.set(id, { resolve, reject, timer: setTimeout(late, timeoutMs), rows: windows.length });
      connection.send(frame);
    });
  }

  /** Ends the connection; what is in flight, and every later request, fails as UNAVAILABLE. */
  close(): void {
    this.closed = true;
    this.connection?.end(new TaxelError("UNAVAILABLE", "the source was closed"));
  }

  private connected(): Connection {
    this.connection ??= this.open(
      this.address,
      (reply) => this.onReply(reply),
      (error) => this.onLost(error),
    );
    return this.connection;
  }

  private nextId(): number {
    do this.lastId = (this.lastId % LARGEST_ID) + 1;
    while (this.inFlight.has(this.lastId));
    return this.lastId;
  }

  private onReply({ id, content }: Reply): void {
    if (id === 0) {
      // The server could not read a frame. It does not say of which request, and closes the connection.
      this.connection?.end(content instanceof TaxelError ? content : new ServerLost("a reply without a request"));
      return;
    }
    const rows = this.inFlight.get(id)?.rows;
    if (!(content instanceof TaxelError) && rows !== undefined && rows !== content.channels.length)
      content = new TaxelError("INTERNAL", `the server answered ${content.channels.length} of ${rows} windows`);
    this.finish(id, content);
  }

  private onLost(error: TaxelError): void {
    this.connection = undefined;
    for (const id of [...this.inFlight.keys()]) this.finish(id, error);
  }

  /** The answer to a request that was given up before finds nobody, and is dropped. */
  private finish(id: number, outcome: Predictions | TaxelError): void {
    const request = this.inFlight.get(id);
    if (request === undefined) return;
    this.inFlight.delete(id);
    clearTimeout(request.timer);
    if (outcome instanceof TaxelError) request.reject(outcome);
    else request.resolve(outcome);
  }
}

function checkedTimeout(timeoutMs: number): number {
  if (timeoutMs > 0 && timeoutMs <= LARGEST_TIMEOUT_MS) return timeoutMs;
  const expected = `expected more than 0 and at most ${LARGEST_TIMEOUT_MS}`;
  throw new TaxelError("INVALID_ARGUMENT", `the timeout is ${timeoutMs} ms; ${expected}`);
}
