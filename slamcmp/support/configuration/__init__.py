"""YAML that knows its places, and the parameters that plug-ins take from it."""
