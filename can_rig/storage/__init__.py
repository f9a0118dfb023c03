"""Output: files and folders, complete or absent; columns of long runs in files without a name.

The room imports only `errors`; every room above may import it.
"""
