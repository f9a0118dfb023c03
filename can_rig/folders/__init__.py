"""Folders of results: rules for replacing, and folders that grow until complete.

Every writer of folders imports `folders`; `folders` imports only `files` and `errors`.
"""
