# The runtime brings no Vulkan of its own: cmake -DNM=nm -DLIBRARIES=a.a,b.a -P no_loader.cmake
# fails if a library has an undefined vk* symbol.
string(REPLACE "," ";" libraries "${LIBRARIES}")
foreach(library ${libraries})
  execute_process(COMMAND ${NM} -u ${library} OUTPUT_VARIABLE symbols RESULT_VARIABLE result)
  if(NOT result EQUAL 0 OR NOT symbols MATCHES "shale")
    message(FATAL_ERROR "${NM} tells nothing of ${library}")
  endif()
  string(REGEX MATCHALL "U vk[A-Za-z0-9]+" found "${symbols}")
  if(found)
    message(FATAL_ERROR "${library} needs of a loader: ${found}")
  endif()
endforeach()
