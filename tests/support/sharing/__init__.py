"""Things that several files of tests share, such as a running cluster."""
