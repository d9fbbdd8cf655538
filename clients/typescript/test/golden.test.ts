/** The golden messages of docs/wire/: the client writes their bytes, and reads from them what was meant. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { TaxelError } from "../src/errors.js";
import { decodeReply, encodeRequest, replyBytes, type Predictions } from "../src/frames.js";
import { decodeTextMap } from "../src/msgpack.js";

const golden = (name: string): Buffer => readFileSync(new URL(`../../../../docs/wire/${name}`, import.meta.url));

const WINDOWS = [0, 1].map((row) => [0, 1, 2, 3, 4, 5].map((i) => (6 * row + i) / 8));
const COUNTS = [0, 1].map((row) => Float32Array.from({ length: 21 }, (_, channel) => 2000 + 21 * row + channel));
const REQUEST = { id: 7, path: "v2/models/skin/infer", windows: WINDOWS, spread: false, timeoutMs: 5000 };

function predictions(name: string): Predictions {
  const frame = golden(name);
  assert.equal(replyBytes(frame.subarray(0, 32)), frame.length);
  const { id, content } = decodeReply(frame);
  assert.equal(id, 7);
  assert.ok(!(content instanceof TaxelError));
  return content;
}

test("a request is written byte for byte", () => {
  assert.deepEqual(Buffer.from(encodeRequest(REQUEST)), golden("lane_request.bin"));
});

test("the flag of the spread is byte 9, and the path is padded to 4 bytes", () => {
  const frame = Buffer.from(encodeRequest({ ...REQUEST, path: "v2/models/skins/infer", spread: true }));
  const expected = golden("lane_request.bin");
  assert.equal(frame.length, expected.length + 4);
  assert.equal(frame[9], 1);
  assert.deepEqual(frame.subarray(56), expected.subarray(52));
});

test("predictions are read", () => {
  const read = predictions("lane_predictions.bin");
  assert.deepEqual(read, { channels: COUNTS, spread: undefined, queueUs: 12, computeUs: 34, batchRows: 2 });
});

test("predictions with the spread are read", () => {
  const read = predictions("lane_predictions_spread.bin");
  assert.deepEqual(read.channels, COUNTS);
  assert.deepEqual(read.spread, COUNTS.map((row) => row.map((count) => Math.fround(count / Math.fround(1000)))));
});

test("an error is read", () => {
  const { id, content } = decodeReply(golden("lane_error.bin"));
  assert.equal(id, 7);
  assert.ok(content instanceof TaxelError);
  assert.deepEqual([content.code, content.message], ["NOT_FOUND", "no model 'skn'; there is: skin, wide"]);
});

test("a head that is no reply is refused, whichever of its fields is wrong", () => {
  const head = golden("lane_predictions.bin").subarray(0, 32);
  for (const at of [0, 4, 8, 9, 10, 16]) {
    const wrong = Buffer.from(head);
    wrong.writeUInt8(wrong.readUInt8(at) ^ 0x40, at);
    assert.throws(() => replyBytes(wrong), { name: "TaxelError", code: "INTERNAL" }, `byte ${at}`);
  }
  const unknownFlag = Buffer.from(head);
  unknownFlag.writeUInt32LE(32 + 3 * 168, 4);
  unknownFlag.writeUInt8(2, 9);
  assert.throws(() => replyBytes(unknownFlag), { name: "TaxelError", code: "INTERNAL" });
});

test("windows of unequal length and a path that is too long are refused before they are sent", () => {
  const refused = { name: "TaxelError", code: "INVALID_ARGUMENT" };
  assert.throws(() => encodeRequest({ ...REQUEST, windows: [[1, 2], [3]] }), refused);
  assert.throws(() => encodeRequest({ ...REQUEST, path: "é".repeat(257) }), refused);
});

test("texts of every length that msgpack has are read, and cut ones refused", () => {
  for (const length of [0, 31, 32, 255, 256, 65_535, 65_536]) {
    const text = Buffer.alloc(length, "a");
    const type = Buffer.alloc(5);
    const bytes = length < 32 ? 0 : length < 256 ? 1 : length < 65_536 ? 2 : 4;
    type.writeUInt8(bytes === 0 ? 0xa0 | length : { 1: 0xd9, 2: 0xda, 4: 0xdb }[bytes], 0);
    if (bytes > 0) type.writeUIntBE(length, 1, bytes);
    const packed = Buffer.concat([Buffer.from([0x81, 0xa1, 0x6b]), type.subarray(0, 1 + bytes), text]);
    assert.equal(decodeTextMap(Buffer.concat([packed, Buffer.alloc(3)])).get("k"), text.toString());
    assert.throws(() => decodeTextMap(packed.subarray(0, -1)), { code: "INTERNAL" });
  }
});
