"""Readers and the writer of a ring in shared memory at the same time, in processes of their own."""
