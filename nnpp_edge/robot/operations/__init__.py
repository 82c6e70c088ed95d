"""Running the loop as a program: what it is connected to, metrics, word to systemd."""
