"""The diagnosis as a record, and the contract of its JSON."""
