// Strict reading of a YAML configuration text into a plain struct. Every problem is collected with
// its place, so that one run reports all:
//   sensor.yaml:3:1: unknown key `hsot`; did you mean `host`
//     hsot: base
//     ^
// Use:
//   absl::StatusOr<SensorConfig> ParseSensorConfig(absl::string_view file, absl::string_view text)
//   {
//     ConfigReader reader(file, text);
//     ConfigSection root = reader.root();
//     SensorConfig config;                                     // defaults are its initialisers
//     root.Required("robot", &config.robot);
//     root.Optional("settle", &config.settle, {absl::ZeroDuration(), absl::Minutes(1)});
//     ConfigSection outbox = root.OptionalSection("outbox");
//     outbox.Optional("memory", &config.outbox_memory, {ByteSize{1 << 20}, ByteSize{1 << 30}});
//     for (ConfigSection& ids : root.Sections("ids")) { ... }
//     RIPS_RETURN_IF_ERROR(reader.Finish());                   // unknown keys are found here
//     return config;
//   }
// A key is known once it was asked for. One thread at a time.
#ifndef RIPS_SERVICES_RUNTIME_CONFIG_READER_H_
#define RIPS_SERVICES_RUNTIME_CONFIG_READER_H_

#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/base/config_setting.h"

namespace rips {

inline constexpr size_t kConfigBytesMax = 1 << 20;
inline constexpr int kConfigDepthMax = 32;     // nested mappings and lists
inline constexpr int kConfigProblemsMax = 50;  // listed; the rest is only counted

// A number of bytes; written `512B`, `64KiB`, `1MiB`, `2GiB`.
struct ByteSize {
  int64_t bytes = 0;
  friend auto operator<=>(const ByteSize&, const ByteSize&) = default;
};

// Allowed values, both ends included.
template <typename T>
struct ConfigRange {
  T min = std::numeric_limits<T>::min();
  T max = std::numeric_limits<T>::max();
};
template <>
struct ConfigRange<absl::Duration> {
  absl::Duration min = absl::ZeroDuration();
  absl::Duration max = absl::InfiniteDuration();
};
template <>
struct ConfigRange<ByteSize> {
  ByteSize min = {0};
  ByteSize max = {std::numeric_limits<int64_t>::max()};
};

// `500ms`, `15s`, `10min`, `2h`, `1d`, also `250us`; a whole number and one unit, without space.
// InvalidArgument otherwise; `0` needs a unit too.
absl::StatusOr<absl::Duration> ParseConfigDuration(absl::string_view text);
// Inverse of ParseConfigDuration, in the largest unit that is exact.
std::string FormatConfigDuration(absl::Duration duration);
// `512B`, `64KiB`, `1MiB`, `2GiB`.
absl::StatusOr<ByteSize> ParseByteSize(absl::string_view text);
std::string FormatByteSize(ByteSize size);

class ConfigTree;  // the parsed text and the problems found so far
struct ConfigNode;

// One mapping of the text, or the absence of one. Cheap to copy; valid while its reader lives.
// A problem is recorded in the reader and leaves `*value` untouched, as an absent key does.
class ConfigSection {
 public:
  // False if the mapping is not in the text (or null): then Optional keeps defaults and Required
  // reports nothing, as the section itself was either optional or already reported.
  bool present() const { return node_ != nullptr; }
  // True if `key` is in the text. Does not make it known.
  bool Has(absl::string_view key) const;
  // The keys of the mapping, in the order of the text: for mappings whose keys are names of the
  // user's. Does not make them known.
  std::vector<std::string> Keys() const;
  // The line, from 1, of the value of `key`, or of the mapping if it has no such key; 0 if the
  // mapping is not in the text.
  int LineOf(absl::string_view key) const;

  // Types: std::string (any scalar, not empty), bool (`true`, `false`), integers in
  // `range`, absl::Duration and ByteSize in `range`, std::vector<std::string>.
  template <typename T>
  void Required(absl::string_view key, T* value, ConfigRange<T> range = {}) const {
    Read(key, value, range, true);
  }
  template <typename T>
  void Optional(absl::string_view key, T* value, ConfigRange<T> range = {}) const {
    Read(key, value, range, false);
  }
  void Required(absl::string_view key, std::string* value) const { ReadString(key, value, true); }
  void Optional(absl::string_view key, std::string* value) const { ReadString(key, value, false); }
  void Required(absl::string_view key, bool* value) const { ReadBool(key, value, true); }
  void Optional(absl::string_view key, bool* value) const { ReadBool(key, value, false); }
  // A list of scalars; Required also refuses an empty one.
  void Required(absl::string_view key, std::vector<std::string>* value) const {
    ReadStrings(key, value, true);
  }
  void Optional(absl::string_view key, std::vector<std::string>* value) const {
    ReadStrings(key, value, false);
  }

  // One of the named values.
  template <typename E>
  using Names = std::vector<std::pair<std::string, E>>;
  template <typename E>
  void RequiredEnum(absl::string_view key, E* value, const Names<E>& names) const {
    ReadEnum(key, value, names, true);
  }
  template <typename E>
  void OptionalEnum(absl::string_view key, E* value, const Names<E>& names) const {
    ReadEnum(key, value, names, false);
  }

  // The mapping under `key`. Absent or null: not present(); a required one is reported.
  ConfigSection RequiredSection(absl::string_view key) const { return Section(key, true); }
  ConfigSection OptionalSection(absl::string_view key) const { return Section(key, false); }
  // The mappings of the list under `key`, in order; empty if absent.
  std::vector<ConfigSection> Sections(absl::string_view key) const;

  // Reports `message` at the value of `key` (at the mapping if it has no such key).
  void Problem(absl::string_view key, absl::string_view message) const;

 private:
  friend class ConfigReader;
  ConfigSection(ConfigTree* tree, ConfigNode* node, std::string path)
      : tree_(tree), node_(node), path_(std::move(path)) {}

  template <typename T>
  void Read(absl::string_view key, T* value, ConfigRange<T> range, bool required) const {
    if constexpr (std::numeric_limits<T>::is_integer) {
      static_assert(sizeof(T) < 8 || std::numeric_limits<T>::is_signed, "use int64_t");
      int64_t wide = static_cast<int64_t>(*value);
      ReadInt(key, &wide, {static_cast<int64_t>(range.min), static_cast<int64_t>(range.max)},
              required);
      *value = static_cast<T>(wide);
    } else {
      ReadQuantity(key, value, range, required);
    }
  }
  void ReadString(absl::string_view key, std::string* value, bool required) const;
  void ReadBool(absl::string_view key, bool* value, bool required) const;
  void ReadInt(absl::string_view key, int64_t* value, ConfigRange<int64_t> range,
               bool required) const;
  void ReadQuantity(absl::string_view key, absl::Duration* value, ConfigRange<absl::Duration> range,
                    bool required) const;
  void ReadQuantity(absl::string_view key, ByteSize* value, ConfigRange<ByteSize> range,
                    bool required) const;
  void ReadStrings(absl::string_view key, std::vector<std::string>* value, bool required) const;
  // Index into `names`, or -1 if absent or not one of them. `now` is the name of the default.
  int ReadName(absl::string_view key, const std::vector<std::string>& names, absl::string_view now,
               bool required) const;
  template <typename E>
  void ReadEnum(absl::string_view key, E* value, const Names<E>& names, bool required) const {
    std::vector<std::string> only_names;
    std::string now;
    for (const auto& [name, each] : names) {
      only_names.push_back(name);
      if (each == *value) now = name;
    }
    const int index = ReadName(key, only_names, now, required);
    if (index >= 0) *value = names[index].second;
  }
  ConfigSection Section(absl::string_view key, bool required) const;
  // The node under `key`, made known; nullptr if absent (reported if `required`).
  ConfigNode* Find(absl::string_view key, bool required) const;
  // As Find, but only a scalar; anything else is reported as not `what`.
  ConfigNode* FindScalar(absl::string_view key, absl::string_view what, bool required) const;
  std::string PathOf(absl::string_view key) const;
  // `value` is in force for `key`.
  void AddSetting(absl::string_view key, absl::string_view value) const;

  ConfigTree* tree_;  // Not owned; outlives this.
  ConfigNode* node_;  // Not owned; nullptr if absent.
  std::string path_;  // `levels[1].enter[0]`; empty at the root
};

class ConfigReader {
 public:
  // `file` is the name used in messages. A text that is not YAML, not a mapping, too long, too
  // deep, or that has duplicate keys, anchors, tags or several documents is a problem, too.
  // Each of `overrides` takes the place of what the text says at its path, which leads through
  // mappings; its value is YAML, and its source stands in settings and problems.
  ConfigReader(absl::string_view file, absl::string_view text,
               std::vector<ConfigSetting> overrides = {});
  ~ConfigReader();
  ConfigReader(const ConfigReader&) = delete;
  ConfigReader& operator=(const ConfigReader&) = delete;

  ConfigSection root();

  // OK, or InvalidArgument with all problems in the order of the text, a line break between them.
  // Call once, when everything has been asked for: what was not asked for is unknown.
  absl::Status Finish();

  // What was read, in the order asked, defaults included: the effective configuration. Meaningful
  // after an OK Finish().
  const std::vector<ConfigSetting>& Settings() const;

 private:
  std::unique_ptr<ConfigTree> tree_;
};

// For --check-config: `path: value  # FILE:LINE` or `# default`, a line each.
std::string FormatSettings(const std::vector<ConfigSetting>& settings);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_CONFIG_READER_H_
