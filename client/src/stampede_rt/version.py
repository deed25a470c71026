"""The version of this software. Client and server tell each other their versions."""

VERSION = "0.1.0"
PROTOCOL_VERSION = 1
