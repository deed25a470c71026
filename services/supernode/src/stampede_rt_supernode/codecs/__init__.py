"""Commands, records and snapshots of the directory, to protobuf and back."""
