"""What runs behind the walls: the worker, and the submission that it loads."""
