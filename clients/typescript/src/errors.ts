/** What a server says when it cannot answer, and what the client itself finds wrong. */

export const CODES = [
  "INVALID_ARGUMENT",
  "NOT_FOUND",
  "RESOURCE_EXHAUSTED",
  "DEADLINE_EXCEEDED",
  "CANCELLED",
  "PERMISSION_DENIED",
  "UNAVAILABLE",
  "INTERNAL",
] as const;

export type Code = (typeof CODES)[number];

/** Any error of this package. `code` is one of the server's, also where the client raised it. */
export class TaxelError extends Error {
  override readonly name: string = "TaxelError";

  constructor(
    readonly code: Code,
    message: string,
  ) {
    super(message);
  }
}

/** The connection was lost, or there is none. The next request connects again. */
export class ServerLost extends TaxelError {
  override readonly name = "ServerLost";

  constructor(message: string) {
    super("UNAVAILABLE", message);
  }
}

/** The server's error. A code that this client does not know counts as INTERNAL, and the text keeps it. */
export function serverError(code: string, text: string): TaxelError {
  const known = CODES.find((each) => each === code);
  return known === undefined
    ? new TaxelError("INTERNAL", `${code}: ${text}`)
    : new TaxelError(known, text);
}
