"""Converts commands, records and snapshots of the directory from and to protobuf."""
