# cmake -D SOURCE=rules/X -D BUNDLE=build/bundles/X -D PLUGIN=PROGRAM -D PLUGIN_ID=ID -P this
#
# Puts a policy with one plugin together: the rule files and tests of SOURCE, the program as
# plugins/ID, and manifest.yaml.in with the program's hash. The manifest is written last, so that
# it never names a program that is not there.
file(GLOB parts ${SOURCE}/*.rul ${SOURCE}/*_test.yaml)
file(COPY ${parts} DESTINATION ${BUNDLE})
file(MAKE_DIRECTORY ${BUNDLE}/plugins)
file(COPY_FILE ${PLUGIN} ${BUNDLE}/plugins/${PLUGIN_ID})
file(CHMOD ${BUNDLE}/plugins/${PLUGIN_ID}
  PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ
              WORLD_EXECUTE)
file(SHA256 ${BUNDLE}/plugins/${PLUGIN_ID} PLUGIN_SHA256)
configure_file(${SOURCE}/manifest.yaml.in ${BUNDLE}/manifest.yaml @ONLY)
file(TOUCH ${BUNDLE}/manifest.yaml)
