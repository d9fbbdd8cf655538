"""What an operator needs of a running server: metrics, health, logs, the service manager, the doctor."""
