// ir/base/result.h -- how every library here reports what a file, an argument or a device can
// cause.
#pragma once

#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace shale {

enum class ErrorCode {
  kBadInput,     ///< a file or an argument breaks a rule
  kUnsupported,  ///< legal, but outside what this build does
  kDevice,       ///< no usable device, or the device failed
  kIo,           ///< the operating system refused a read or a write
};

/// One clear sentence: what was found and what was expected; `where` names file, node or offset, and
/// `file` the file around it where that is known apart.
struct Error {
  ErrorCode code = ErrorCode::kBadInput;
  std::string message;
  std::string where;
  std::string file = {};

  /// "file: where: message", without what is empty.
  std::string text() const {
    std::string text = file;
    for (const std::string& part : {where, message})
      if (!part.empty()) text += (text.empty() ? "" : ": ") + part;
    return text;
  }
};

template <typename... Args>
Error bad_input(std::string where, fmt::format_string<Args...> format, Args&&... args) {
  return {ErrorCode::kBadInput, fmt::format(format, std::forward<Args>(args)...), std::move(where)};
}

template <typename... Args>
Error unsupported(std::string where, fmt::format_string<Args...> format, Args&&... args) {
  return {ErrorCode::kUnsupported, fmt::format(format, std::forward<Args>(args)...),
          std::move(where)};
}

template <typename... Args>
Error device_error(std::string where, fmt::format_string<Args...> format, Args&&... args) {
  return {ErrorCode::kDevice, fmt::format(format, std::forward<Args>(args)...), std::move(where)};
}

template <typename... Args>
Error io_error(std::string where, fmt::format_string<Args...> format, Args&&... args) {
  return {ErrorCode::kIo, fmt::format(format, std::forward<Args>(args)...), std::move(where)};
}

[[noreturn]] inline void check_failed(const char* condition, const char* file, int line) {
  std::fprintf(stderr, "%s:%d: internal error: %s\n", file, line, condition);
  std::abort();
}

/// A T or an Error; the member names are those of std::expected. To ask for the one where it holds
/// the other is a bug, and ends the program with what it holds.
template <typename T>
class [[nodiscard]] Result {
 public:
  using value_type = T;
  // "value" would shadow a member where T is a pointer to a function, says g++ 12.
  Result(T result) : state_(std::in_place_index<0>, std::move(result)) {}
  Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}

  bool has_value() const { return state_.index() == 0; }
  explicit operator bool() const { return has_value(); }
  T& value() & { return *held<0>(state_); }
  const T& value() const& { return *held<0>(state_); }
  T&& value() && { return std::move(value()); }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }
  T&& operator*() && { return std::move(value()); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  Error& error() { return *held<1>(state_); }
  const Error& error() const { return *held<1>(state_); }

 private:
  template <size_t kIndex, typename State>
  static auto* held(State& state) {
    if (state.index() != kIndex) {
      const std::string what = kIndex == 0 ? "a value is asked of a Result that holds the error: " +
                                                 std::get_if<1>(&state)->text()
                                           : "an error is asked of a Result that holds a value";
      check_failed(what.c_str(), __FILE__, __LINE__);
    }
    return std::get_if<kIndex>(&state);
  }

  std::variant<T, Error> state_;
};

template <>
class [[nodiscard]] Result<void> {
 public:
  using value_type = void;
  Result() = default;
  Result(Error error) : error_(std::move(error)) {}

  bool has_value() const { return !error_.has_value(); }
  explicit operator bool() const { return has_value(); }
  Error& error() {
    check_error();
    return *error_;
  }
  const Error& error() const {
    check_error();
    return *error_;
  }

 private:
  void check_error() const {
    if (!error_) check_failed("an error is asked of a Result that holds none", __FILE__, __LINE__);
  }

  std::optional<Error> error_;
};

}  // namespace shale

/// Aborts on what only a bug of ours can cause.
#define SHALE_CHECK(condition) \
  ((condition) ? void(0) : ::shale::check_failed(#condition, __FILE__, __LINE__))

#define SHALE_CONCAT_INNER(a, b) a##b
#define SHALE_CONCAT(a, b) SHALE_CONCAT_INNER(a, b)

/// SHALE_TRY(auto x, expression): returns the error, or defines x from the value.
#define SHALE_TRY(declaration, ...)                                  \
  auto SHALE_CONCAT(shale_result_, __LINE__) = (__VA_ARGS__);        \
  if (!SHALE_CONCAT(shale_result_, __LINE__))                        \
    return std::move(SHALE_CONCAT(shale_result_, __LINE__).error()); \
  declaration = *std::move(SHALE_CONCAT(shale_result_, __LINE__))

/// SHALE_TRY_VOID(expression): returns the error, if there is one.
#define SHALE_TRY_VOID(...)                                                                       \
  do {                                                                                            \
    if (auto shale_status = (__VA_ARGS__); !shale_status) return std::move(shale_status.error()); \
  } while (false)
