"""Who may do what, in the directory: rules, and the key of client tokens. Pure."""
