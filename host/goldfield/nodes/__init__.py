"""The boards on a link: who they are, what they say of themselves, and the conversation with them."""
