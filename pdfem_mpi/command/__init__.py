"""What a person types and sees: commands, console, studies."""
