"""The recordings everybody cites: a module each, with licence, citation, size and official address.

An entry is a function that returns a :class:`~slamcmp.datasets.fetching.data_set.DataSet`. A size or a
checksum stands in it only where it was seen; elsewhere ``slamcmp data info`` says that it is not known.
"""
