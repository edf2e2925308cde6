#include "pipeline/batch_job.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

namespace limber {
namespace {

using nlohmann::json;

Error bad_field(const std::string& pointer, const std::string& what, const std::string& hint) {
  return {.code = "job-field",
          .message = fmt::format("at {}: {}", pointer.empty() ? "/" : pointer, what),
          .hint = hint};
}

/// Reads a job field by field; the first fault ends it.
class JobReader {
 public:
  Result<BatchJob> read(const json& document) {
    if (!document.is_object()) return bad_field("", "a job is an object", kExample);
    for (const auto& [key, value] : document.items()) {
      if (auto r = read_field(key, value); !r) return r.error();
    }
    for (const char* needed : {"sources", "targets", "output"}) {
      if (!document.contains(needed)) {
        return bad_field(std::string("/") + needed, "missing", kExample);
      }
    }
    return std::move(job_);
  }

 private:
  static constexpr const char* kExample =
      R"(such as {"sources": ["clips/**/*.bvh"], "targets": ["hand"], "output": "out"})";

  Result<void> read_field(const std::string& key, const json& value) {
    const std::string pointer = "/" + key;
    if (key == "$schema" || key == "description") return {};
    if (key == "sources") return read_sources(value);
    if (key == "targets") return read_targets(value);
    if (key == "output") return read_output(value);
    if (key == "map") return read_text(value, pointer, job_.map);
    if (key == "options") return read_options(value);
    if (key == "caps") return read_caps(value);
    if (key == "gates") return read_text(value, pointer, job_.gates);
    if (key == "rig") return bad_field(pointer, "not supported yet", "leave it out");
    return bad_field(pointer, "no such field",
                     "there are sources, targets, output, map, gates, options and caps");
  }

  static Result<void> read_text(const json& value, const std::string& pointer, std::string& out) {
    if (!value.is_string() || value.get_ref<const std::string&>().empty()) {
      return bad_field(pointer, "expected a text that is not empty", "write it in quotes");
    }
    out = value.get<std::string>();
    if (out.find('\0') != std::string::npos) {
      return bad_field(pointer, "a zero character", "leave it out");
    }
    return {};
  }

  static Result<void> check_list(const json& value, const std::string& pointer) {
    if (value.is_array() && !value.empty()) return {};
    return bad_field(pointer, "expected a list that is not empty", "write it in [ ]");
  }

  Result<void> read_sources(const json& value) {
    if (auto r = check_list(value, "/sources"); !r) return r;
    for (std::size_t i = 0; i < value.size(); ++i) {
      std::string text;
      if (auto r = read_text(value[i], fmt::format("/sources/{}", i), text); !r) return r;
      job_.sources.push_back(std::move(text));
    }
    return {};
  }

  Result<void> read_targets(const json& value) {
    if (auto r = check_list(value, "/targets"); !r) return r;
    for (std::size_t i = 0; i < value.size(); ++i) {
      const std::string pointer = fmt::format("/targets/{}", i);
      BatchTarget target;
      if (!value[i].is_object()) {
        if (auto r = read_text(value[i], pointer, target.path); !r) return r;
      } else {
        for (const auto& [key, field] : value[i].items()) {
          if (key != "path" && key != "map") {
            return bad_field(pointer + "/" + key, "no such field", "there are path and map");
          }
          std::string& out = key == "path" ? target.path : target.map;
          if (auto r = read_text(field, pointer + "/" + key, out); !r) return r;
        }
        if (target.path.empty()) return bad_field(pointer + "/path", "missing", "name the target");
      }
      job_.targets.push_back(std::move(target));
    }
    return {};
  }

  Result<void> read_output(const json& value) {
    std::string text;
    if (auto r = read_text(value, "/output", text); !r) return r;
    job_.output = text;
    return {};
  }

  /// The text of a flag; nullopt where JSON has no such form.
  static std::optional<std::string> flag_text(const json& value) {
    if (value.is_string()) return value.get<std::string>();
    if (value.is_boolean()) return value.get<bool>() ? "on" : "off";
    if (value.is_number()) return value.dump();
    return std::nullopt;
  }

  Result<void> read_options(const json& value) {
    if (!value.is_object()) return bad_field("/options", "expected an object", R"({"rate": 30})");
    static const std::set<std::string, std::less<>> kElsewhere = {
        "target", "output", "map", "gates", "junit", "jobs", "json", "help"};
    for (const auto& [key, option] : value.items()) {
      const std::string pointer = "/options/" + key;
      if (kElsewhere.contains(key) || key.empty() || key.starts_with("-")) {
        return bad_field(pointer, "no option of a clip",
                         "options are the long flags of `limber retarget`, without dashes");
      }
      std::string text;
      for (const json& part : option.is_array() ? option : json::array({option})) {
        const auto one = flag_text(part);
        if (!one) return bad_field(pointer, "expected a text, a number or a list of them", "");
        text += (text.empty() ? "" : ",") + *one;
      }
      job_.flags.push_back({pointer, {"--" + key + "=" + text}});
    }
    job_.options_text = value.dump(-1, ' ', false, json::error_handler_t::replace);
    return {};
  }

  Result<void> read_caps(const json& value) {
    if (!value.is_object()) return bad_field("/caps", "expected an object", R"({"wall_s": 600})");
    for (const auto& [key, cap] : value.items()) {
      const std::string pointer = "/caps/" + key;
      constexpr std::int64_t kMost = 1 << 24;  // MiB: 16 TiB; seconds: half a year
      if (!cap.is_number_integer() || cap < 1 || cap > kMost) {
        return bad_field(pointer, "expected a whole number above zero", "");
      }
      const auto number = cap.get<std::uint32_t>();
      if (key == "memory_mb") {
        job_.caps.memory_bytes = std::uint64_t(number) << 20;
      } else if (key == "output_mb") {
        job_.caps.file_bytes = std::uint64_t(number) << 20;
      } else if (key == "cpu_s") {
        job_.caps.cpu_seconds = number;
      } else if (key == "wall_s") {
        job_.caps.wall_seconds = number;
      } else {
        return bad_field(pointer, "no such cap",
                         "there are memory_mb, output_mb, cpu_s and wall_s");
      }
    }
    return {};
  }

  BatchJob job_;
};

}  // namespace

Result<BatchJob> job_from_json(std::string_view text) {
  try {
    return JobReader().read(json::parse(text, nullptr, true, /*ignore_comments=*/true));
  } catch (const json::exception& e) {
    return Error{
        .code = "job-json", .message = e.what(), .hint = "the job must be one JSON document"};
  }
}

Result<Shard> parse_shard(const std::string& text) {
  Shard shard;
  const char* const end = text.data() + text.size();
  const auto first = std::from_chars(text.data(), end, shard.number);
  if (first.ec == std::errc() && first.ptr != end && *first.ptr == '/') {
    const auto second = std::from_chars(first.ptr + 1, end, shard.count);
    const bool whole = second.ec == std::errc() && second.ptr == end;
    if (whole && shard.number >= 1 && shard.number <= shard.count) return shard;
  }
  return Error{.code = "job-shard",
               .message = "'" + text + "' is no shard",
               .hint = "give I/N with 1 <= I <= N, such as 2/7"};
}

}  // namespace limber
