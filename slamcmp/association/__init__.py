"""Which detection is of which landmark: decisions on predicted innovations, whoever predicted them."""
