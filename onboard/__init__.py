"""heft's flight computer side: records to vehicle time, to rows, to an estimate, to a log; and back from the log."""
