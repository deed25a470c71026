"""Between values and their protobuf form. The only modules of the client beside its shells that touch stubs."""
