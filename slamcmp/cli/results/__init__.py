"""Commands about results folders."""
