"""The pages of people and their keys, of logging in, and of second factors."""
