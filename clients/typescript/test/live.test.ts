/** Against a real server, over both kinds of lane, and over a WebSocket to the server of the second. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { Source } from "../src/index.js";
import { askPython, freePort, makeRepository, pause, type Server, startServer, stop } from "./server.js";

const NUMBERS = 12;
const folder = mkdtempSync(join(tmpdir(), "taxel-"));
const repository = makeRepository(folder);
const unix = `unix:${join(folder, "lane.sock")}`;
const tcp = `tcp:127.0.0.1:${await freePort()}`;
const webSocket = `127.0.0.1:${await freePort()}`;
const patient = { timeoutMs: 60_000 };
const sources = {
  unix: new Source(unix, patient),
  tcp: new Source(tcp, patient),
  ws: new Source(`ws://${webSocket}/`, patient),
};
/** The lane of the server that a source asks. */
const laneOf = (source: Source): string => (source === sources.unix ? unix : tcp);
const start = (lane: string): Promise<Server> => startServer(repository, lane, lane === tcp ? ["--websocket", webSocket] : []);
const running = new Map<string, Server>();

/** The same numbers each time: contacts of some millimetres and newtons. */
const windows = Array.from({ length: 200 }, (_, row) =>
  Float32Array.from({ length: NUMBERS }, (_, i) => (((row * NUMBERS + i) * 7919) % 1000) / 1000 - 0.5),
);
const first = windows.slice(0, 1);

before(async () => {
  for (const lane of [unix, tcp]) running.set(lane, await start(lane));
});

after(async () => {
  Object.values(sources).forEach((source) => source.close());
  for (const server of running.values()) await stop(server, "SIGTERM");
  rmSync(folder, { recursive: true });
});

const bytes = (rows: readonly Float32Array[]): Buffer =>
  Buffer.concat(rows.map((row) => Buffer.from(row.buffer, row.byteOffset, row.byteLength)));

test("the README's example prints what it shows", () => {
  const readme = readFileSync(new URL("../../README.md", import.meta.url), "utf8");
  const block = (language: string): string => new RegExp(`\`\`\`${language}\n(.*?)\`\`\``, "s").exec(readme)![1]!;
  const example = block("ts").replace("tcp:127.0.0.1:7448", tcp).replace('timeoutMs: 2000', 'timeoutMs: 60000');
  const run = ["--input-type=module", "--eval", example];
  const printed = execFileSync(process.execPath, run, { cwd: new URL("../..", import.meta.url), encoding: "utf8" });
  assert.equal(printed, block("output"));
});

for (const [kind, source] of Object.entries(sources)) {
  test(`${kind}: 64 requests in flight get the Python client's numbers, bit for bit`, async () => {
    const expected = askPython(running.get(laneOf(source))!.endpoint, windows);
    // Of 1 to 4 windows each, so that an answer in another one's place is seen.
    const starts = Array.from({ length: 64 }, (_, i) => 3 * i);
    const parts = starts.map((start, i) => windows.slice(start, start + 1 + (i % 4)));
    const replies = await Promise.all(parts.map((part) => source.infer("xgb", part)));
    replies.forEach((reply, i) => {
      const start = 84 * starts[i]!;
      assert.deepEqual(bytes(reply.channels), expected.subarray(start, start + 84 * parts[i]!.length), `request ${i}`);
      assert.ok(reply.batchRows >= parts[i]!.length);
      assert.equal(reply.spread, undefined);
    });
    assert.deepEqual(bytes((await source.infer("xgb", windows, { version: "1" })).channels), expected);
  });

  test(`${kind}: what a server refuses has its code, and the connection goes on`, async () => {
    const rejects = (call: Promise<unknown>, code: string, message: RegExp): Promise<void> =>
      assert.rejects(call, { name: "TaxelError", code, message });
    const bad = Float32Array.from(first[0]!);
    bad[1] = Number.NaN;
    await rejects(source.infer("skn", first), "NOT_FOUND", /no model 'skn'.* xgb/);
    await rejects(source.infer("xgb", first, { version: "99" }), "NOT_FOUND", /'99'/);
    await rejects(source.infer("x/y", first), "NOT_FOUND", /x\/y/);
    await rejects(source.infer("xgb", [[1, 2, 3]]), "INVALID_ARGUMENT", /\[1, 3\].* \[n, 12\]/);
    await rejects(source.infer("xgb", [bad]), "INVALID_ARGUMENT", /nan/);
    await rejects(source.infer("xgb", first, { spread: true }), "INVALID_ARGUMENT", /spread/);
    if (kind !== "ws") await rejects(source.infer("xgb", Array(65_537).fill(first[0])), "RESOURCE_EXHAUSTED", /65537/);
    else await rejects(source.infer("xgb", Array(21_900).fill(first[0])), "RESOURCE_EXHAUSTED", /at most 1048576/);
    await rejects(source.infer("xgb", first, { timeoutMs: 1e-6 }), "DEADLINE_EXCEEDED", /./);
    assert.equal((await source.infer("xgb", first)).channels.length, 1);
  });

  test(`${kind}: what is in flight when a server is killed fails as ServerLost, and a later call connects again`, async () => {
    const lane = laneOf(source);
    await pause(running.get(lane)!); // So that the request cannot be answered before.
    const lost = Array.from({ length: 3 }, () => source.infer("xgb", first));
    const rejected = lost.map((call) => assert.rejects(call, { name: "ServerLost", code: "UNAVAILABLE" }));
    await stop(running.get(lane)!, "SIGKILL");
    await Promise.all(rejected);
    await assert.rejects(source.infer("xgb", first), { name: "ServerLost", code: "UNAVAILABLE" });
    running.set(lane, await start(lane));
    assert.equal((await source.infer("xgb", first)).channels.length, 1);
  });
}
