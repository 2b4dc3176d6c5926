"""What `battery-postproc NAME` runs."""
