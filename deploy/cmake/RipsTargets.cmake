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
define_property(TARGET PROPERTY RIPS_WIRE BRIEF_DOCS "Whether it links rips::proto or gRPC")

# What most files include, compiled once for each set of headers and of options. `wire`, for clang,
# has what is generated from proto/ as well, and gRPC (proto/CMakeLists.txt). The test `tidy` sees
# to it that a file names the headers of what it uses.
set(RIPS_COMMON_HEADERS
    <algorithm> <atomic> <cstdint> <deque> <filesystem> <fstream> <functional> <map> <memory>
    <optional> <set> <sstream> <string> <thread> <utility> <variant> <vector>
    <absl/container/btree_map.h> <absl/container/flat_hash_map.h> <absl/status/statusor.h>
    <absl/strings/escaping.h> <absl/strings/match.h> <absl/strings/numbers.h>
    <absl/strings/str_cat.h> <absl/strings/str_format.h> <absl/strings/str_join.h>
    <absl/strings/str_replace.h> <absl/strings/str_split.h> <absl/time/clock.h>
    <absl/time/time.h>)
set(RIPS_TEST_HEADERS <gmock/gmock.h> <gtest/gtest.h>)

# rips_headers(NAME wire_test [LIKE wire] HEADERS <gtest/gtest.h> DEPS GTest::gmock OPTIONS -O0)
function(rips_headers)
  cmake_parse_arguments(A "" "NAME;LIKE" "HEADERS;DEPS;OPTIONS" ${ARGN})
  if(A_LIKE)
    get_target_property(headers rips_${A_LIKE}_headers PRECOMPILE_HEADERS)
    get_target_property(deps rips_${A_LIKE}_headers LINK_LIBRARIES)
    list(PREPEND A_HEADERS ${headers})
    list(PREPEND A_DEPS ${deps})
  endif()
  set(target rips_${A_NAME}_headers)
  add_library(${target} OBJECT ${PROJECT_SOURCE_DIR}/deploy/cmake/common_headers.cc)
  set_target_properties(${target} PROPERTIES UNITY_BUILD OFF)
  target_compile_options(${target} PRIVATE ${A_OPTIONS})
  if(CMAKE_CXX_COMPILER_ID STREQUAL "Clang")  # the same bytes from the same headers, for ccache
    target_compile_options(${target} PRIVATE "SHELL:-Xclang -fno-pch-timestamp")
  endif()
  target_link_libraries(${target} PRIVATE Threads::Threads ${A_DEPS})
  target_precompile_headers(${target} PRIVATE ${A_HEADERS})
endfunction()
rips_headers(NAME common HEADERS ${RIPS_COMMON_HEADERS})
rips_headers(NAME common_test LIKE common HEADERS ${RIPS_TEST_HEADERS} DEPS GTest::gmock
             OPTIONS -O0)

# Sets `out` to whether one of `deps` links what is generated from proto/, or gRPC.
function(_rips_sees_wire out)
  set(${out} FALSE PARENT_SCOPE)
  foreach(dep IN LISTS ARGN)
    if(dep MATCHES "^(gRPC::|rips::proto)")
      set(${out} TRUE PARENT_SCOPE)
    elseif(TARGET ${dep})
      get_target_property(wire ${dep} RIPS_WIRE)
      if(wire)
        set(${out} TRUE PARENT_SCOPE)
      endif()
    endif()
  endforeach()
endfunction()

# _rips_precompiled(target DEPS rips::base [SUFFIX _test]): the headers for a target of these links.
# GCC takes a second to read `wire`, in all more than it saves; clang reads what a file uses.
function(_rips_precompiled target)
  cmake_parse_arguments(A "" "SUFFIX" "DEPS" ${ARGN})
  _rips_sees_wire(wire ${A_DEPS})
  set_target_properties(${target} PROPERTIES RIPS_WIRE ${wire})
  set(from common)
  if(wire AND CMAKE_CXX_COMPILER_ID STREQUAL "Clang")
    set(from wire)
  endif()
  target_precompile_headers(${target} REUSE_FROM rips_${from}${A_SUFFIX}_headers)
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
    _rips_precompiled(rips_${A_NAME} DEPS ${A_DEPS})
    if(A_NO_UNITY)
      set_target_properties(rips_${A_NAME} PROPERTIES UNITY_BUILD OFF)
    endif()
  else()
    add_library(rips_${A_NAME} INTERFACE)
    set(scope INTERFACE)
    _rips_sees_wire(wire ${A_DEPS})
    set_target_properties(rips_${A_NAME} PROPERTIES RIPS_WIRE ${wire})
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
  _rips_precompiled(${A_NAME} DEPS ${A_DEPS})
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
  _rips_precompiled(${A_NAME}_test SUFFIX _test DEPS ${A_DEPS})
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
