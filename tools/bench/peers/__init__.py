"""Other software on our problems, for comparison only: what each can state of them, in a few lines each.

A section of the comparison is a module with two functions: `run(logs, folder)` measures what has no file in the folder
yet, and `report(folder)` makes the section's Markdown from the files.
"""
