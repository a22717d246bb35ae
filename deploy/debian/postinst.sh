[ "$1" = configure ] || exit 0
on_configure "$2"
make_directories "$2"
for unit in $(services) $triggers; do
  # So that a purge takes back what the administrator enables.
  deb-systemd-helper update-state "$unit" >/dev/null || true
done
if has_systemd; then
  systemctl --system daemon-reload >/dev/null || true
  if [ -n "$2" ]; then restart_daemons; fi
fi
