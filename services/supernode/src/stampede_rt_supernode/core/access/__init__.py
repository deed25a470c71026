"""Rights in the directory: rules of access, and the key of client tokens. Pure."""
