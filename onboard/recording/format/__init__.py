"""The bytes of a log: MCAP records, schemas, chunks, segments; scanned and decoded."""
