"""What closes a worker in: each layer, their order, and the proofs that they hold."""
