"""The audit log: append-only, hash-chained, with a seal on every row that it tells of; its export and verification."""
