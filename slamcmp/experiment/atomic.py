"""Moved to :mod:`slamcmp.atomic`."""

from slamcmp.atomic import storage_error as storage_error
from slamcmp.atomic import write_atomically as write_atomically
from slamcmp.errors import StorageError as StorageError
