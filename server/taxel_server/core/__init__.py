"""The server without a transport: what admits, batches and answers requests."""
