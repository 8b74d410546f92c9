"""What every back end must keep."""
