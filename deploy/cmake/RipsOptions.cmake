# Compiler set-up that every target of this project shares.
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
add_compile_options(-pthread)
# Programs name their source files from here: the same bytes wherever the sources lie.
add_compile_options("-ffile-prefix-map=${PROJECT_SOURCE_DIR}/=")
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin)

set(RIPS_SANITIZE "" CACHE STRING "Value of -fsanitize= for every target; empty for none")
option(RIPS_WITH_GRPC "Build what links gRPC; off under ThreadSanitizer, which cannot see into it" ON)
option(RIPS_FUZZ "Link the fuzz targets with libFuzzer instead of the corpus replayer (clang)" OFF)

find_program(RIPS_CCACHE ccache)
if(RIPS_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  # Precompiled headers are part of what a file is compiled from.
  set(CMAKE_CXX_COMPILER_LAUNCHER
      ${CMAKE_COMMAND} -E env CCACHE_SLOPPINESS=pch_defines,time_macros ${RIPS_CCACHE})
  set(CMAKE_C_COMPILER_LAUNCHER ${RIPS_CCACHE})
endif()

find_program(RIPS_LLD ld.lld)
if(RIPS_LLD)
  add_link_options(-fuse-ld=lld)
endif()

if(RIPS_SANITIZE)
  add_compile_options(-fsanitize=${RIPS_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${RIPS_SANITIZE})
  add_compile_definitions(RIPS_SANITIZED)
endif()

# Kept out of generated code, which is not ours to mend.
set(RIPS_WARNINGS -Wall -Wextra -Werror -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual
    -Wunused -Wcast-qual -Wimplicit-fallthrough -Wno-missing-field-initializers)
if(CMAKE_CXX_COMPILER_ID STREQUAL "Clang")
  list(APPEND RIPS_WARNINGS -Wthread-safety -Werror=thread-safety)
endif()
