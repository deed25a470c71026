# Generated from ../_async by tools/generate.py; do not edit.
"""The client. This folder is the source; `tools/generate.py` makes the blocking client in `_sync` from it."""
