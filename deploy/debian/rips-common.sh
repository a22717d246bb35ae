on_configure() {
  systemd-sysusers rips.conf
  # Without /proc, as in some chroots, it is done at the next boot.
  systemd-tmpfiles --create rips.conf || true
}
