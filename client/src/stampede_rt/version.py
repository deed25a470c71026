"""What this software is, for the other side to know."""

VERSION = "0.1.0"
PROTOCOL_VERSION = 1
