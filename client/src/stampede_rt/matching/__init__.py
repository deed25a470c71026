"""The rule of matches over the times and seqs of items, which hosts and clients share. Pure."""
