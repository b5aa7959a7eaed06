"""What to change where there is no plan: changes of the task that were planned and certified before they are told."""
