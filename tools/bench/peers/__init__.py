"""Other software on our problems, for comparison only: what each can state of them, in a few lines each."""
