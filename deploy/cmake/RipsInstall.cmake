# Which file belongs to which Debian package: a component of `cmake --install` is a package of
# deploy/debian/control. deploy/package installs each component into a directory of its own and adds
# what is generated (manual pages, control files).
#
# On a robot, programs use the libraries of rips-agent-libs (deploy/debian/agent_libraries.py) by
# DT_RPATH, which holds for what these libraries need, too. DT_RUNPATH does not.
set(agent_programs rips-sensor rips-wire rips-actuator rips-exec rips-fw rips-alarm
    rips-enrol)
set_target_properties(${agent_programs} PROPERTIES
  BUILD_WITH_INSTALL_RPATH ON INSTALL_RPATH "$ORIGIN/../lib/rips/lib")
foreach(program IN LISTS agent_programs)
  target_link_options(${program} PRIVATE LINKER:--disable-new-dtags)
endforeach()

# Units, sysusers.d and tmpfiles.d are where Debian 12 looks for them, whatever the prefix is.
set(RIPS_DOC share/doc)

function(_rips_install_directories component)  # PATH...: empty ones, 0755
  foreach(path IN LISTS ARGN)
    install(DIRECTORY DESTINATION ${path} COMPONENT ${component})
  endforeach()
endfunction()
function(_rips_install_units component)  # NAME.service|socket|timer...
  list(TRANSFORM ARGN PREPEND ${PROJECT_SOURCE_DIR}/deploy/systemd/ OUTPUT_VARIABLE units)
  install(FILES ${units} DESTINATION /lib/systemd/system COMPONENT ${component})
endfunction()
function(_rips_install_examples component)  # NAME...: of deploy/config
  list(TRANSFORM ARGN PREPEND ${PROJECT_SOURCE_DIR}/deploy/config/ OUTPUT_VARIABLE files)
  install(FILES ${files} DESTINATION ${RIPS_DOC}/${component}/examples COMPONENT ${component})
endfunction()

# Users, /run/rips, and the directories that packages share. Those that belong to a user are made
# when the package is configured (deploy/debian/PACKAGE.sh).
install(FILES deploy/sysusers/rips.conf DESTINATION /usr/lib/sysusers.d COMPONENT rips-common)
install(FILES deploy/tmpfiles/rips.conf DESTINATION /usr/lib/tmpfiles.d COMPONENT rips-common)
_rips_install_directories(rips-common /etc/rips/pki /var/lib/rips)

# The server and ripsctl both start these, and look for them beside themselves.
install(TARGETS rips-inspect rips-scan DESTINATION bin COMPONENT rips-inspect)

install(TARGETS rips-policy-server DESTINATION bin COMPONENT rips-policy-server)
_rips_install_units(rips-policy-server rips-policy-server.service)
_rips_install_examples(rips-policy-server policy-server.yaml robots.yaml)
install(PROGRAMS deploy/pki/external-ca-openssl
        DESTINATION ${RIPS_DOC}/rips-policy-server/examples COMPONENT rips-policy-server)
install(FILES deploy/logrotate/rips-policy-server DESTINATION /etc/logrotate.d
        COMPONENT rips-policy-server)
_rips_install_directories(rips-policy-server /etc/rips/bundles)

install(TARGETS rips-sensor rips-wire DESTINATION bin COMPONENT rips-sensor)
_rips_install_units(rips-sensor rips-sensor.service rips-wire.service)
_rips_install_examples(rips-sensor sensor.yaml)

install(TARGETS rips-actuator rips-exec rips-fw rips-alarm DESTINATION bin
        COMPONENT rips-actuator)
_rips_install_units(rips-actuator rips-actuator.service rips-exec.service rips-exec.socket
                    rips-fw.service rips-fw.socket)
_rips_install_examples(rips-actuator actuator.yaml alert.nft smh.yaml)
install(FILES deploy/udev/70-rips-alarm.rules DESTINATION /lib/udev/rules.d
        COMPONENT rips-actuator)

install(TARGETS rips-enrol DESTINATION bin COMPONENT rips-enrol)
_rips_install_units(rips-enrol rips-enrol-renew.service rips-enrol-renew.timer)

install(TARGETS ripsctl DESTINATION bin COMPONENT rips-tools)
install(PROGRAMS deploy/pki/mint DESTINATION bin RENAME rips-mint COMPONENT rips-tools)
_rips_install_examples(rips-tools ripsctl.yaml)
install(FILES deploy/prometheus/rips.rules.yml deploy/grafana/rips.json
        DESTINATION ${RIPS_DOC}/rips-tools/examples COMPONENT rips-tools)
install(FILES rules/LANGUAGE.md rules/PROTOTYPE.md policy_server/METRICS.md deploy/RUNBOOK.md
        DESTINATION ${RIPS_DOC}/rips-tools COMPONENT rips-tools)
install(DIRECTORY deploy/handbook DESTINATION ${RIPS_DOC}/rips-tools COMPONENT rips-tools
        FILES_MATCHING PATTERN "*.md")
install(FILES policy_server/audit/FORMAT.md DESTINATION ${RIPS_DOC}/rips-tools RENAME AUDIT.md
        COMPONENT rips-tools)
install(DIRECTORY deploy/schema DESTINATION share/rips COMPONENT rips-tools)
install(PROGRAMS deploy/security/keystore DESTINATION share/rips/security COMPONENT rips-tools)
install(DIRECTORY deploy/security DESTINATION share/rips COMPONENT rips-tools
        FILES_MATCHING PATTERN "*.xml" PATTERN "*.md")
# One that needs a plugin is complete only where the build has put it together.
file(GLOB policies CONFIGURE_DEPENDS rules/*/manifest.yaml)
list(TRANSFORM policies REPLACE "/[^/]*$" "")
install(DIRECTORY ${policies} DESTINATION share/rips/policies COMPONENT rips-tools)
