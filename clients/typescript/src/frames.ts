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
export function encodeRequest(request: Request): Buffer {
  const path = Buffer.from(request.path, "utf8");
  if (path.length > PATH_LIMIT)
    throw new TaxelError("INVALID_ARGUMENT", `the path has ${path.length} bytes; at most ${PATH_LIMIT} are allowed`);
  const numbers = request.windows[0]?.length ?? 0;
  const start = HEAD_BYTES + padded(path.length);
  const size = start + 4 * request.windows.length * numbers;
  if (size > UINT32_LIMIT)
    throw new TaxelError("INVALID_ARGUMENT", `the request has ${size} bytes; at most ${UINT32_LIMIT} fit a frame`);
  const frame = Buffer.alloc(size);
  frame.writeUInt32BE(MAGIC, 0);
  frame.writeUInt32LE(size, 4);
  frame.writeUInt8(REQUEST, 8);
  frame.writeUInt8(request.spread ? 1 : 0, 9);
  frame.writeUInt16LE(path.length, 10);
  frame.writeUInt32LE(request.id, 12);
  frame.writeUInt32LE(request.windows.length, 16);
  frame.writeUInt32LE(numbers, 20);
  frame.writeDoubleLE(request.timeoutMs, 24);
  path.copy(frame, HEAD_BYTES);
  let at = start;
  request.windows.forEach((window, row) => {
    if (window.length !== numbers)
      throw new TaxelError(
        "INVALID_ARGUMENT",
        `window ${row} has ${window.length} numbers, and window 0 has ${numbers}; all windows have the same length`,
      );
    // Not writeFloatLE: it is checked at each call, and a request may hold a million numbers.
    const view = new DataView(frame.buffer, frame.byteOffset + at, 4 * numbers);
    for (let i = 0; i < numbers; i++) view.setFloat32(4 * i, window[i] as number, true);
    at += 4 * numbers;
  });
  return frame;
}

/** The bytes of the whole frame that starts with `head`, of 32 bytes. Raises INTERNAL if it is no reply. */
export function replyBytes(head: Buffer): number {
  const kind = head.readUInt8(8);
  const size = head.readUInt32LE(4);
  if (head.readUInt32BE(0) !== MAGIC || (kind !== PREDICTIONS && kind !== ERROR))
    throw new TaxelError("INTERNAL", "what came from the server is no reply of the lane");
  const rows = head.readUInt32LE(16);
  const spread = head.readUInt8(9);
  const right =
    kind === ERROR
      ? size > HEAD_BYTES && size <= HEAD_BYTES + ERROR_LIMIT
      : size === HEAD_BYTES + 4 * CHANNELS * rows * (1 + spread) && spread <= 1 && head.readUInt16LE(10) === CHANNELS;
  if (!right) throw new TaxelError("INTERNAL", `the server's reply of ${size} bytes contradicts its head`);
  return size;
}

/** `frame` is one whole frame, whose head `replyBytes` has accepted. */
export function decodeReply(frame: Buffer): Reply {
  const id = frame.readUInt32LE(12);
  if (frame.readUInt8(8) === ERROR) {
    const message = decodeTextMap(frame.subarray(HEAD_BYTES));
    return { id, content: serverError(message.get("code") ?? "INTERNAL", message.get("error") ?? "no text") };
  }
  const rows = frame.readUInt32LE(16);
  const channels = decodeRows(frame, HEAD_BYTES, rows);
  const spread = frame.readUInt8(9) === 1 ? decodeRows(frame, HEAD_BYTES + 4 * CHANNELS * rows, rows) : undefined;
  const batchRows = frame.readUInt32LE(20);
  const [queueUs, computeUs] = [frame.readUInt32LE(24), frame.readUInt32LE(28)];
  return { id, content: { channels, spread, queueUs, computeUs, batchRows } };
}

function decodeRows(frame: Buffer, start: number, rows: number): Float32Array[] {
  const view = new DataView(frame.buffer, frame.byteOffset + start, 4 * CHANNELS * rows);
  return Array.from({ length: rows }, (_, row) =>
    Float32Array.from({ length: CHANNELS }, (_, channel) => view.getFloat32(4 * (row * CHANNELS + channel), true)),
  );
}
