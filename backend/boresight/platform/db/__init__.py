"""The database: engines, transactions, lists, the chain of audit records and its seals."""
