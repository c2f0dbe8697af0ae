"""Messages to people: mail, chat and push, each person's own addresses and choice of kinds."""
