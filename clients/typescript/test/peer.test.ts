/** Whoever listens at a lane's address may be slow, silent, or no server at all. */

import assert from "node:assert/strict";
import { once } from "node:events";
import { chownSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer, type AddressInfo, type Socket } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";

import { Source } from "../src/index.js";

const WINDOWS = [[0], [0]];

/** A source of a listener that does `answer` once a request has come. */
async function withPeer(answer: (socket: Socket) => void, ask: (source: Source) => Promise<void>): Promise<void> {
  const sockets: Socket[] = [];
  const listener = createServer((socket) => {
    sockets.push(socket);
    socket.on("error", () => undefined);
    socket.once("data", () => answer(socket));
  }).listen(0, "127.0.0.1");
  await once(listener, "listening");
  const source = new Source(`tcp:127.0.0.1:${(listener.address() as AddressInfo).port}`, { timeoutMs: 60_000 });
  try {
    await ask(source);
  } finally {
    source.close();
    sockets.forEach((socket) => socket.destroy());
    listener.close();
  }
}

/** The golden predictions, as the answer to the request with this id. */
function goldenReply(id: number): Buffer {
  const frame = readFileSync(new URL("../../../../docs/wire/lane_predictions.bin", import.meta.url));
  frame.writeUInt32LE(id, 12);
  return frame;
}

test("a reply that comes in pieces is put together, and one to nobody's request is dropped", () =>
  withPeer(
    (socket) => {
      socket.setNoDelay(true);
      const replies = Buffer.concat([goldenReply(99), goldenReply(1)]);
      // Pieces of 7 bytes: no head, and no reply, comes whole.
      const send = (at: number): void => {
        if (at < replies.length) socket.write(replies.subarray(at, at + 7), () => setImmediate(send, at + 7));
      };
      send(0);
    },
    async (source) => {
      const { channels } = await source.infer("skin", WINDOWS);
      assert.deepEqual(channels.map((row) => row[20]), [2020, 2041]);
    },
  ));

test("a reply with another number of windows is no answer", () =>
  withPeer(
    (socket) => socket.write(goldenReply(1)),
    (source) => assert.rejects(source.infer("skin", [[0]]), { code: "INTERNAL", message: /2 of 1 windows/ }),
  ));

test("bytes that are no reply end the connection, and all that is in flight", () =>
  withPeer(
    (socket) => socket.write("HTTP/1.1 400 Bad Request\r\n\r\n".repeat(4)),
    async (source) => {
      const refused = { code: "INTERNAL", message: /no reply of the lane/ };
      const calls = [source.infer("skin", WINDOWS), source.infer("skin", WINDOWS)];
      await Promise.all(calls.map((call) => assert.rejects(call, refused)));
    },
  ));

test("a silent server is not waited for longer than the timeout", () =>
  withPeer(
    () => undefined,
    (source) => assert.rejects(source.infer("skin", WINDOWS, { timeoutMs: 20 }), { code: "DEADLINE_EXCEEDED" }),
  ));

test("closing ends what is in flight, and what comes later", () =>
  withPeer(
    () => undefined,
    async (source) => {
      const closed = { code: "UNAVAILABLE", message: /was closed/ };
      const inFlight = assert.rejects(source.infer("skin", WINDOWS), closed);
      await new Promise(setImmediate);
      source.close();
      await inFlight;
      await assert.rejects(source.infer("skin", WINDOWS), closed);
    },
  ));

test("wrong addresses and timeouts are refused by name", async () => {
  for (const address of ["", "7448", "tcp:127.0.0.1", "tcp:127.0.0.1:0", "tcp::80x", "udp:127.0.0.1:80", "unix:"])
    await assert.rejects(new Source(address).infer("xgb", WINDOWS), {
      code: "INVALID_ARGUMENT",
      message: /expected unix:PATH/,
    });
  for (const timeoutMs of [0, -1, Number.NaN, Infinity, 2 ** 31])
    assert.throws(() => new Source("unix:x", { timeoutMs }), { code: "INVALID_ARGUMENT", message: /timeout/ });
});

test("another user's socket is not connected to", { skip: process.getuid?.() !== 0 && "needs root" }, async () => {
  const folder = mkdtempSync(join(tmpdir(), "taxel-"));
  const path = join(folder, "lane.sock");
  writeFileSync(path, "");
  chownSync(path, 12_345, -1);
  const refused = { code: "PERMISSION_DENIED", message: /user 12345/ };
  await assert.rejects(new Source(`unix:${path}`).infer("xgb", WINDOWS), refused);
  rmSync(folder, { recursive: true });
});
