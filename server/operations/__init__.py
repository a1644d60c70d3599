"""Operations: health, metrics, the log's levels, and the service manager."""
