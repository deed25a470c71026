"""Object stores: closed segments move there, and reads fetch their bytes by range."""
