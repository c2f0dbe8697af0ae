"""What makes a release: the artefacts, what they contain, under which licences, and that nobody changed them. Not in the wheel."""
