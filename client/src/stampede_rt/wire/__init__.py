"""Converts values to and from protobuf. In the client, only these modules and the shells use generated code."""
