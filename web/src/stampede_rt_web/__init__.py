"""`stampede web`: a page that shows the streams of a cluster on one time line. It uses the public client only."""
