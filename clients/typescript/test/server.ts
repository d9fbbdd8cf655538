/** A real server in a process of its own, and the Python client beside it. */

import { spawn, spawnSync, type ChildProcess } from "node:child_process";
import { once } from "node:events";
import { cpSync } from "node:fs";
import { createServer, type AddressInfo } from "node:net";
import { join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import { fileURLToPath } from "node:url";

const CHECKOUT = fileURLToPath(new URL("../../../../", import.meta.url));
const PYTHON = process.env["TAXEL_PYTHON"] ?? join(CHECKOUT, ".venv", "bin", "python");

/** A repository with the shipped trees alone: a server of all models takes longer to start. */
export function makeRepository(folder: string): string {
  const repository = join(folder, "repository");
  cpSync(join(CHECKOUT, "models", "repository", "xgb"), join(repository, "xgb"), { recursive: true });
  return repository;
}

export async function freePort(): Promise<number> {
  const probe = createServer().listen(0, "127.0.0.1");
  await once(probe, "listening");
  const { port } = probe.address() as AddressInfo;
  probe.close();
  await once(probe, "close");
  return port;
}

export interface Server {
  readonly process: ChildProcess;
  /** Where it listens for zenoh. */
  readonly endpoint: string;
}

/** Resolves when the server is ready: it prints one JSON object then. */
export async function startServer(repository: string, lane: string, more: readonly string[] = []): Promise<Server> {
  const endpoint = `tcp/127.0.0.1:${await freePort()}`;
  const options = ["--repository", repository, "--listen", endpoint, "--lane", lane, "--json", ...more];
  const server = spawn(PYTHON, ["-m", "taxel", "serve", ...options], { stdio: ["ignore", "pipe", "inherit"] });
  await Promise.race([
    once(server.stdout, "data"),
    once(server, "close").then(([code]) => Promise.reject(new Error(`the server stopped with ${String(code)}`))),
  ]);
  return { process: server, endpoint };
}

export async function stop(server: Server, signal: NodeJS.Signals): Promise<void> {
  const stopped = once(server.process, "exit");
  server.process.kill(signal);
  await stopped;
}

/** Resolves when the process stands still: a signal takes its time. */
export async function pause(server: Server): Promise<void> {
  server.process.kill("SIGSTOP");
  const state = (): string => spawnSync("ps", ["-o", "state=", "-p", String(server.process.pid)], { encoding: "utf8" }).stdout;
  while (!state().startsWith("T")) await sleep(10);
}

/** The bytes of the n × 21 float32 that the Python client gets over zenoh. */
export function askPython(endpoint: string, windows: readonly Float32Array[]): Buffer {
  const program = `
import json, sys
import numpy as np
import taxel
windows = np.array(json.load(sys.stdin), np.float32)
with taxel.connect(${JSON.stringify(endpoint)}, transport="zenoh") as source:
    print(source.predictor("xgb").predict(windows).astype("<f4").tobytes().hex())
`;
  const input = JSON.stringify(windows.map((window) => [...window]));
  const { status, stdout, stderr } = spawnSync(PYTHON, ["-c", program], { input, encoding: "utf8", maxBuffer: 2 ** 26 });
  if (status !== 0) throw new Error(stderr);
  return Buffer.from(stdout.trim(), "hex");
}
