"""A filter's error state: the charts it is kept in, and where its Jacobians are taken."""
