# shale_library(name SOURCES ... [DEPENDS ...])    a static library of one room
# shale_test(name SOURCES ... DEPENDS ... LABELS ...)   a GoogleTest program, one CTest entry
# shale_embed(target OUTPUT file.h NAMESPACE ns ROOT dir FILES ...)   text files as C++ string literals

if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # -Wrestrict is left out: g++ 12 reports it falsely for std::string (GCC bug 105651).
  set(SHALE_WARNINGS -Wall -Wextra -Wconversion -Wshadow -Wno-restrict)
  # Off where code is instrumented: g++ 12 then warns of copies that cannot be.
  option(SHALE_WARNINGS_AS_ERRORS "stop at a warning" ON)
  if(SHALE_WARNINGS_AS_ERRORS)
    list(APPEND SHALE_WARNINGS -Werror)
  endif()
else()
  set(SHALE_WARNINGS -Wall -Wextra)  # the fuzz targets; g++ is the compiler of record
endif()

function(shale_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS" ${ARGN})
  add_library(${name} STATIC ${ARG_SOURCES})
  target_include_directories(${name} PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}> $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/generated>
    $<INSTALL_INTERFACE:include/shale>)
  target_compile_options(${name} PRIVATE ${SHALE_WARNINGS} -fno-rtti)
  target_link_libraries(${name} PUBLIC ${ARG_DEPENDS})
  set_target_properties(${name} PROPERTIES POSITION_INDEPENDENT_CODE ON)
endfunction()

function(shale_test name)
  cmake_parse_arguments(ARG "" "TIMEOUT" "SOURCES;DEPENDS;LABELS" ${ARGN})
  if(NOT SHALE_BUILD_TESTS)
    return()
  endif()
  add_executable(${name} ${ARG_SOURCES})
  target_include_directories(${name} PRIVATE ${PROJECT_SOURCE_DIR})
  # Little optimization: tests spend their time in the libraries and the driver. g++ 12 also reports
  # uninitialized members of std::vector in inlined test code, falsely (GCC bug 105562).
  target_compile_options(${name} PRIVATE ${SHALE_WARNINGS} -O1 -Wno-maybe-uninitialized)
  target_compile_definitions(${name} PRIVATE
    SHALE_SOURCE_DIR="${PROJECT_SOURCE_DIR}" SHALE_BINARY_DIR="${PROJECT_BINARY_DIR}")
  target_link_libraries(${name} PRIVATE ${ARG_DEPENDS} GTest::gtest_main)
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 1800)
  endif()
  add_test(NAME ${name} COMMAND ${name})
  set_tests_properties(${name} PROPERTIES LABELS "${ARG_LABELS}" TIMEOUT ${ARG_TIMEOUT})
endfunction()

function(shale_embed target)
  cmake_parse_arguments(ARG "" "OUTPUT;NAMESPACE;ROOT" "FILES" ${ARGN})
  set(inputs)
  foreach(file ${ARG_FILES})
    list(APPEND inputs ${ARG_ROOT}/${file})
  endforeach()
  set(output ${PROJECT_BINARY_DIR}/generated/${ARG_OUTPUT})
  string(REPLACE ";" "," files "${ARG_FILES}")
  add_custom_command(OUTPUT ${output}
    COMMAND ${CMAKE_COMMAND} -DOUTPUT=${output} -DNAMESPACE=${ARG_NAMESPACE} -DROOT=${ARG_ROOT}
            -DFILES=${files} -P ${PROJECT_SOURCE_DIR}/tools/cmake/embed.cmake
    DEPENDS ${inputs} ${PROJECT_SOURCE_DIR}/tools/cmake/embed.cmake VERBATIM)
  target_sources(${target} PRIVATE ${output})
endfunction()

# shale_flatbuffers(name): generates generated/ir/schema/<name>_generated.h; target shale_schema_<name>.
function(shale_flatbuffers name)
  set(output ${PROJECT_BINARY_DIR}/generated/ir/schema/${name}_generated.h)
  add_custom_command(OUTPUT ${output}
    COMMAND ${FLATC} --cpp --scoped-enums -o ${PROJECT_BINARY_DIR}/generated/ir/schema
            ${PROJECT_SOURCE_DIR}/ir/schema/${name}.fbs
    DEPENDS ${PROJECT_SOURCE_DIR}/ir/schema/${name}.fbs VERBATIM)
  add_custom_target(shale_schema_${name} DEPENDS ${output})
endfunction()
