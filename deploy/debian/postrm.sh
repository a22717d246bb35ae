if [ "$1" = remove ] && has_systemd; then
  systemctl --system daemon-reload >/dev/null || true
fi
if [ "$1" = purge ]; then
  for unit in $(services) $triggers; do
    deb-systemd-helper purge "$unit" >/dev/null || true
  done
  echo "$directories" | while read -r path rest; do
    [ -n "$path" ] || continue
    rm -rf "$path" || echo "$DPKG_MAINTSCRIPT_PACKAGE: cannot remove all of $path" >&2
  done
fi
