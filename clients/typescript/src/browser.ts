/** For web pages: nothing here is Node's. */

import { SourceBy, type SourceOptions } from "./source.js";
import { WebSocketConnection } from "./web_socket.js";

export { CODES, ServerLost, TaxelError, type Code } from "./errors.js";
export { CHANNELS, type Predictions } from "./frames.js";
export type { InferOptions, SourceOptions } from "./source.js";

/** A server at its address for pages, `ws://HOST:PORT/`. */
export class Source extends SourceBy {
  constructor(address: string, options: SourceOptions = {}) {
    super((...given) => new WebSocketConnection(...given), address, options);
  }
}
