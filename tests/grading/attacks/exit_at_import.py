"""Kind: ending the process.
Wins if leaving while being imported is taken for success.
Defence: an end without an answer is a failure.
"""

import os

os._exit(0)
