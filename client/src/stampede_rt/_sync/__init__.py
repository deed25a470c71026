# Generated from ../_async by tools/generate.py; do not edit.
"""The client. This folder is the source; its synchronous twin is generated from it (see tools/generate.py)."""
