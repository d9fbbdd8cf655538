/** As much of msgpack as the lane needs: the map of texts that an error is (https://github.com/msgpack/msgpack). */

import { TaxelError } from "./errors.js";

/** The map at the start of `bytes`; what follows it is padding. Raises INTERNAL for anything but a map of texts. */
export function decodeTextMap(bytes: Uint8Array): Map<string, string> {
  const pairs = bytes[0] ?? 0;
  if (pairs >> 4 !== 0x8) throw unreadable();
  const map = new Map<string, string>();
  let at = 1;
  const text = (): string => {
    const [start, length] = textPlace(bytes, at);
    if (start + length > bytes.length) throw unreadable();
    at = start + length;
    return new TextDecoder().decode(bytes.subarray(start, at));
  };
  for (let pair = 0; pair < (pairs & 0xf); pair++) {
    const key = text();
    map.set(key, text());
  }
  return map;
}

/** Where the text whose type byte is at `at` starts, and its bytes. */
function textPlace(bytes: Uint8Array, at: number): readonly [number, number] {
  const type = bytes[at] ?? 0;
  if (type >> 5 === 0b101) return [at + 1, type & 0x1f];
  const width = { 0xd9: 1, 0xda: 2, 0xdb: 4 }[type];
  if (width === undefined || at + 1 + width > bytes.length) throw unreadable();
  const length = bytes.subarray(at + 1, at + 1 + width).reduce((above, byte) => 256 * above + byte, 0);
  return [at + 1 + width, length];
}

const unreadable = (): TaxelError => new TaxelError("INTERNAL", "the server's error is no map of texts in msgpack");
