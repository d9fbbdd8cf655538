/** The lane's frames, as docs/wire_lane.md lays them out: a head of 32 bytes, then the content. */

import { decodeTextMap } from "./msgpack.js";
import { serverError, TaxelError } from "./errors.js";

export const HEAD_BYTES = 32;
export const CHANNELS = 21;
const MAGIC = 0x54584c31; // "TXL1", read as a big-endian number
const REQUEST = 1;
const PREDICTIONS = 2;
const ERROR = 3;
const PATH_LIMIT = 512;
const ERROR_LIMIT = 65_536;
const UINT32_LIMIT = 2 ** 32 - 1;

export interface Request {
  /** Of the reply, too; 1 to 2³²−1, and unique among the requests in flight. */
  readonly id: number;
  readonly path: string;
  /** n windows of f numbers each. */
  readonly windows: readonly ArrayLike<number>[];
  readonly spread: boolean;
  /** What the server has left to answer, in milliseconds; 0 for no limit. */
  readonly timeoutMs: number;
}

export interface Predictions {
  /** n rows of 21 counts. */
  readonly channels: readonly Float32Array[];
  /** n rows of 21 counts, of an ensemble whose spread was asked for. */
  readonly spread: readonly Float32Array[] | undefined;
  /** From the request's arrival at the server until its evaluation began, in microseconds. */
  readonly queueUs: number;
  /** Of the evaluation, in microseconds. */
  readonly computeUs: number;
  /** Windows that were evaluated together. */
  readonly batchRows: number;
}

export interface Reply {
  /** Of the request; 0 if the server could not read one, after which it closes the connection. */
  readonly id: number;
  readonly content: Predictions | TaxelError;
}

const padded = (bytes: number): number => Math.ceil(bytes / 4) * 4;

/** Raises INVALID_ARGUMENT for windows of unequal length, and for what no frame can hold. */
export function encodeRequest(request: Request): Uint8Array<ArrayBuffer> {
  const path = new TextEncoder().encode(request.path);
  if (path.length > PATH_LIMIT)
    throw new TaxelError("INVALID_ARGUMENT", `the path has ${path.length} bytes; at most ${PATH_LIMIT} are allowed`);
  const numbers = request.windows[0]?.length ?? 0;
  const start = HEAD_BYTES + padded(path.length);
  const size = start + 4 * request.windows.length * numbers;
  if (size > UINT32_LIMIT)
    throw new TaxelError("INVALID_ARGUMENT", `the request has ${size} bytes; at most ${UINT32_LIMIT} fit a frame`);
  const frame = new Uint8Array(size);
  const view = new DataView(frame.buffer);
  view.setUint32(0, MAGIC);
  view.setUint32(4, size, true);
  view.setUint8(8, REQUEST);
  view.setUint8(9, request.spread ? 1 : 0);
  view.setUint16(10, path.length, true);
  view.setUint32(12, request.id, true);
  view.setUint32(16, request.windows.length, true);
  view.setUint32(20, numbers, true);
  view.setFloat64(24, request.timeoutMs, true);
  frame.set(path, HEAD_BYTES);
  let at = start;
  request.windows.forEach((window, row) => {
    if (window.length !== numbers)
      throw new TaxelError(
        "INVALID_ARGUMENT",
        `window ${row} has ${window.length} numbers, and window 0 has ${numbers}; all windows have the same length`,
      );
    for (let i = 0; i < numbers; i++) view.setFloat32(at + 4 * i, window[i] as number, true);
    at += 4 * numbers;
  });
  return frame;
}

const viewOf = (bytes: Uint8Array): DataView => new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);

/** The bytes of the whole frame that starts with `head`, of 32 bytes. Raises INTERNAL if it is no reply. */
export function replyBytes(head: Uint8Array): number {
  const view = viewOf(head);
  const kind = view.getUint8(8);
  const size = view.getUint32(4, true);
  if (view.getUint32(0) !== MAGIC || (kind !== PREDICTIONS && kind !== ERROR))
    throw new TaxelError("INTERNAL", "what came from the server is no reply of the lane");
  const rows = view.getUint32(16, true);
  const spread = view.getUint8(9);
  const right =
    kind === ERROR
      ? size > HEAD_BYTES && size <= HEAD_BYTES + ERROR_LIMIT
      : size === HEAD_BYTES + 4 * CHANNELS * rows * (1 + spread) && spread <= 1 && view.getUint16(10, true) === CHANNELS;
  if (!right) throw new TaxelError("INTERNAL", `the server's reply of ${size} bytes contradicts its head`);
  return size;
}

/** `frame` is one whole frame, whose head `replyBytes` has accepted. */
export function decodeReply(frame: Uint8Array): Reply {
  const view = viewOf(frame);
  const id = view.getUint32(12, true);
  if (view.getUint8(8) === ERROR) {
    const message = decodeTextMap(frame.subarray(HEAD_BYTES));
    return { id, content: serverError(message.get("code") ?? "INTERNAL", message.get("error") ?? "no text") };
  }
  const rows = view.getUint32(16, true);
  const channels = decodeRows(view, HEAD_BYTES, rows);
  const spread = view.getUint8(9) === 1 ? decodeRows(view, HEAD_BYTES + 4 * CHANNELS * rows, rows) : undefined;
  const batchRows = view.getUint32(20, true);
  const [queueUs, computeUs] = [view.getUint32(24, true), view.getUint32(28, true)];
  return { id, content: { channels, spread, queueUs, computeUs, batchRows } };
}

function decodeRows(view: DataView, start: number, rows: number): Float32Array[] {
  return Array.from({ length: rows }, (_, row) =>
    Float32Array.from({ length: CHANNELS }, (_, channel) =>
      view.getFloat32(start + 4 * (row * CHANNELS + channel), true),
    ),
  );
}
