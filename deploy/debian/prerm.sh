if [ "$1" = remove ] && has_systemd; then
  for unit in $triggers $(services); do
    deb-systemd-invoke stop "$unit" >/dev/null || true
  done
fi
