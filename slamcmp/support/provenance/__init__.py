"""What a result was made by: the version of code, and files that were read without being declared."""
