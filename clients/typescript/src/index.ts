export { CODES, ServerLost, TaxelError, type Code } from "./errors.js";
export { CHANNELS, type Predictions } from "./frames.js";
export { Source, type InferOptions, type SourceOptions } from "./source.js";
