"""The figures of the paper (section 6), and the costs that the time model promises."""
