"""Code that all demos share: role processes and their reports, the film, puts in real time, accounting."""
