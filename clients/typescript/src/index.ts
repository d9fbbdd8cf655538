/** For Node. */

import { LaneConnection } from "./lane_connection.js";
import { SourceBy, type SourceOptions } from "./source.js";
import { WebSocketConnection } from "./web_socket.js";

export { CODES, ServerLost, TaxelError, type Code } from "./errors.js";
export { CHANNELS, type Predictions } from "./frames.js";
export type { InferOptions, SourceOptions } from "./source.js";

/** A server at its lane's address: `unix:PATH` or `tcp:HOST:PORT`; or at its address for pages, `ws://HOST:PORT/`. */
export class Source extends SourceBy {
  constructor(address: string, options: SourceOptions = {}) {
    const Connection = /^wss?:/.test(address) ? WebSocketConnection : LaneConnection;
    super((...given) => new Connection(...given), address, options);
  }
}
