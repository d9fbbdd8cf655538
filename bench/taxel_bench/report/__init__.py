"""`bench report`: the tables of a page of results, written again from the JSON files that it names."""
