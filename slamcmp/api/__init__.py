"""What ``import slamcmp`` offers to programs and notebooks; nothing is imported before it is used."""
