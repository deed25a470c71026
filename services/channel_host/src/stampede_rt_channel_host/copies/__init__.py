"""The shell of copies: the feeds to copies at other hosts, and the copies at this host."""
