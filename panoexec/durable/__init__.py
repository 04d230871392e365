"""What makes damage on disk visible: seals over stored data, and the state of SQLite's write-ahead log."""
