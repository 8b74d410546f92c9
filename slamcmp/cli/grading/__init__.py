"""Commands about assignments and hand-ins."""
