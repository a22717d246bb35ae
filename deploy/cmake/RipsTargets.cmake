# rips_library(NAME lang LAYER pure SRCS a.cc HDRS b.h DEPS rips::base absl::strings)
# rips_binary(NAME rips-sensor SRCS main.cc DEPS ...)         -> bin/rips-sensor
# rips_test(NAME lang SRCS lexer_test.cc DEPS rips::lang [LABEL unit|component|integration])
#
# NO_UNITY: the files of the target share names inside anonymous namespaces, so the presets that
# build several files as one must not.
#
# A header belongs to the library of the .cc of its name, one without to the library whose HDRS name
# it. targets.txt in the build directory lists what belongs to what; the test `tidy` checks that no
# file includes a header of a library that its own does not link.
#
# LAYER is one of: base < pure < port < adapter < shell. A target may link only rips:: targets of
# its own layer or a lower one; `base`, `pure` and `port` may link no third-party target outside
# RIPS_PURE_THIRD_PARTY. A violation stops the configure step.
set(RIPS_LAYERS base pure port adapter shell)
set(RIPS_PURE_THIRD_PARTY absl:: PkgConfig::RE2)
define_property(TARGET PROPERTY RIPS_RANK BRIEF_DOCS "Position of the target's layer")

# What most files include, compiled once for libraries and once for tests. The sanitizer builds do
# without, so that a file which names too few headers does not build there.
set(RIPS_COMMON_HEADERS
    <algorithm> <atomic> <cstdint> <deque> <filesystem> <fstream> <functional> <map> <memory>
    <optional> <set> <sstream> <string> <thread> <utility> <variant> <vector>
    <absl/container/btree_map.h> <absl/container/flat_hash_map.h> <absl/status/statusor.h>
    <absl/strings/escaping.h> <absl/strings/match.h> <absl/strings/numbers.h>
    <absl/strings/str_cat.h> <absl/strings/str_format.h> <absl/strings/str_join.h>
    <absl/strings/str_replace.h> <absl/strings/str_split.h> <absl/time/clock.h>
    <absl/time/time.h>)
if(NOT RIPS_SANITIZE)
  add_library(rips_common_headers STATIC ${CMAKE_CURRENT_LIST_DIR}/common_headers.cc)
  target_precompile_headers(rips_common_headers PRIVATE ${RIPS_COMMON_HEADERS})
  add_library(rips_common_test_headers STATIC ${CMAKE_CURRENT_LIST_DIR}/common_headers.cc)
  target_compile_options(rips_common_test_headers PRIVATE -O0)
  target_compile_definitions(rips_common_test_headers PRIVATE GTEST_HAS_PTHREAD=1)
  target_precompile_headers(rips_common_test_headers PRIVATE
    ${RIPS_COMMON_HEADERS} <gmock/gmock.h> <gtest/gtest.h>)
endif()

# _rips_common_headers(target rips_common_headers|rips_common_test_headers)
function(_rips_common_headers target from)
  if(TARGET ${from})
    target_precompile_headers(${target} REUSE_FROM ${from})
  endif()
endfunction()

function(_rips_check_dep target rank dep)
  if(dep MATCHES "^rips::(.+)$")
    if(NOT TARGET rips_${CMAKE_MATCH_1})
      message(FATAL_ERROR "${target}: ${dep} is not declared yet; add its folder earlier")
    endif()
    get_target_property(dep_rank rips_${CMAKE_MATCH_1} RIPS_RANK)
    if(dep_rank STREQUAL "dep_rank-NOTFOUND")
      message(FATAL_ERROR "${dep} has no layer; declare it with rips_library")
    endif()
    if(dep_rank GREATER rank)
      list(GET RIPS_LAYERS ${rank} layer)
      message(FATAL_ERROR "${target} (${layer}) must not depend on ${dep}: higher layer")
    endif()
  elseif(rank LESS_EQUAL 2)
    set(allowed FALSE)
    foreach(prefix IN LISTS RIPS_PURE_THIRD_PARTY)
      string(FIND "${dep}" "${prefix}" at)
      if(at EQUAL 0)
        set(allowed TRUE)
      endif()
    endforeach()
    if(NOT allowed)
      list(GET RIPS_LAYERS ${rank} layer)
      message(FATAL_ERROR "${target} is ${layer}: third-party '${dep}' is not allowed")
    endif()
  endif()
endfunction()

# One line of targets.txt: NAME|LAYER|files|rips:: targets it links.
function(_rips_list name layer files deps)
  list(TRANSFORM files PREPEND "${CMAKE_CURRENT_SOURCE_DIR}/" REGEX "^[^/$]")
  set(normal)
  foreach(file IN LISTS files)
    if(NOT file MATCHES "^\\$<")
      cmake_path(NORMAL_PATH file)
      cmake_path(RELATIVE_PATH file BASE_DIRECTORY ${PROJECT_SOURCE_DIR})
      list(APPEND normal ${file})
    endif()
  endforeach()
  list(FILTER deps INCLUDE REGEX "^rips::")
  list(JOIN normal " " normal)
  list(JOIN deps " " deps)
  set_property(GLOBAL APPEND_STRING PROPERTY RIPS_TARGETS "${name}|${layer}|${normal}|${deps}\n")
endfunction()

# Last of all: writes targets.txt.
function(rips_write_targets)
  get_property(targets GLOBAL PROPERTY RIPS_TARGETS)
  file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/targets.txt CONTENT "${targets}" @ONLY)
endfunction()

function(rips_library)
  cmake_parse_arguments(A "NO_UNITY" "NAME;LAYER" "SRCS;HDRS;DEPS" ${ARGN})
  _rips_list(rips::${A_NAME} "${A_LAYER}" "${A_SRCS};${A_HDRS}" "${A_DEPS}")
  list(FIND RIPS_LAYERS "${A_LAYER}" rank)
  if(rank EQUAL -1)
    message(FATAL_ERROR "rips::${A_NAME}: unknown LAYER '${A_LAYER}'")
  endif()
  foreach(dep IN LISTS A_DEPS)
    _rips_check_dep(rips::${A_NAME} ${rank} ${dep})
  endforeach()
  if(A_SRCS)
    add_library(rips_${A_NAME} STATIC ${A_SRCS})
    set(scope PUBLIC)
    target_compile_options(rips_${A_NAME} PRIVATE ${RIPS_WARNINGS})
    _rips_common_headers(rips_${A_NAME} rips_common_headers)
    if(A_NO_UNITY)
      set_target_properties(rips_${A_NAME} PROPERTIES UNITY_BUILD OFF)
    endif()
  else()
    add_library(rips_${A_NAME} INTERFACE)
    set(scope INTERFACE)
  endif()
  add_library(rips::${A_NAME} ALIAS rips_${A_NAME})
  set_target_properties(rips_${A_NAME} PROPERTIES RIPS_RANK ${rank})
  target_include_directories(rips_${A_NAME} ${scope} ${PROJECT_SOURCE_DIR})
  target_link_libraries(rips_${A_NAME} ${scope} ${A_DEPS})
endfunction()

function(rips_binary)
  cmake_parse_arguments(A "" "NAME" "SRCS;DEPS" ${ARGN})
  _rips_list(${A_NAME} binary "${A_SRCS}" "${A_DEPS}")
  add_executable(${A_NAME} ${A_SRCS})
  target_compile_options(${A_NAME} PRIVATE ${RIPS_WARNINGS})
  target_include_directories(${A_NAME} PRIVATE ${PROJECT_SOURCE_DIR})
  target_link_libraries(${A_NAME} PRIVATE ${A_DEPS})
endfunction()

# Sets `out` to whether a test of these files has no thread: it links pure code only, and starts none.
function(_rips_is_single_threaded out files deps)
  set(${out} TRUE PARENT_SCOPE)
  foreach(dep IN LISTS deps)
    if(dep MATCHES "^rips::(.+)$")
      set(rank 2)  # of one that tests/support defines later nothing is known yet
      if(TARGET rips_${CMAKE_MATCH_1})
        get_target_property(rank rips_${CMAKE_MATCH_1} RIPS_RANK)
      endif()
      if(rank GREATER 1)
        set(${out} FALSE PARENT_SCOPE)
      endif()
    endif()
  endforeach()
  foreach(file IN LISTS files)
    file(STRINGS ${file} threads REGEX "std::(thread|async|atomic)|<(thread|future|atomic)>")
    if(threads)
      set(${out} FALSE PARENT_SCOPE)
    endif()
  endforeach()
endfunction()

function(rips_test)
  cmake_parse_arguments(A "NO_UNITY" "NAME;LABEL;TIMEOUT" "SRCS;HDRS;DEPS" ${ARGN})
  if(RIPS_SANITIZE STREQUAL "thread")
    _rips_is_single_threaded(single "${A_SRCS}" "${A_DEPS}")
    if(single)
      return()  # ThreadSanitizer finds nothing there
    endif()
  endif()
  if(NOT A_LABEL)
    set(A_LABEL unit)
  endif()
  if(NOT A_TIMEOUT)
    set(A_TIMEOUT 120)
    if(NOT A_LABEL STREQUAL unit)
      set(A_TIMEOUT 300)  # real processes and connections, on a machine that builds beside them
    endif()
  endif()
  if(RIPS_SANITIZE)
    math(EXPR A_TIMEOUT "3 * ${A_TIMEOUT}")
  endif()
  _rips_list(${A_NAME}_test test "${A_SRCS};${A_HDRS}" "${A_DEPS}")
  add_executable(${A_NAME}_test ${A_SRCS})
  set_target_properties(${A_NAME}_test PROPERTIES
    RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/tests)
  # What is tested is optimised; the tests themselves are built quickly.
  target_compile_options(${A_NAME}_test PRIVATE ${RIPS_WARNINGS} -O0)
  _rips_common_headers(${A_NAME}_test rips_common_test_headers)
  if(A_NO_UNITY)
    set_target_properties(${A_NAME}_test PROPERTIES UNITY_BUILD OFF)
  endif()
  target_compile_definitions(${A_NAME}_test PRIVATE
    RIPS_SOURCE_DIR="${PROJECT_SOURCE_DIR}" RIPS_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  target_include_directories(${A_NAME}_test PRIVATE ${PROJECT_SOURCE_DIR})
  target_link_libraries(${A_NAME}_test PRIVATE ${A_DEPS} GTest::gmock_main)
  add_test(NAME ${A_NAME} COMMAND ${A_NAME}_test)
  set_tests_properties(${A_NAME} PROPERTIES LABELS ${A_LABEL} TIMEOUT ${A_TIMEOUT})
endfunction()
