"""The version of this software, which each side tells the other."""

VERSION = "0.1.0"
PROTOCOL_VERSION = 1
