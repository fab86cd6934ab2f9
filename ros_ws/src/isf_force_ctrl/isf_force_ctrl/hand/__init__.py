"""Movement of one tool by hand: where it may go, how it goes there, and who moves it."""
