// The words of the rule language.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_TOKEN_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_TOKEN_H_

#include <cstdint>
#include <string>

namespace rips::lang {

enum class TokenKind : uint32_t {
#define RIPS_TOKEN(name, description) k##name,
#define RIPS_KEYWORD(name, spelling) k##name,
#define RIPS_SYMBOL(name, spelling) k##name,
#include "policy_server/policy/lang/syntax/token_kind.def"
};

// A sign is no part of a number: `-1` is two tokens. A string's range includes its quotes.
struct Token {
  TokenKind kind = TokenKind::kError;
  // Bytes from the start of the file.
  uint32_t offset = 0;
  uint32_t length = 0;

  uint32_t end() const { return offset + length; }
};

// For messages: "`=>`", "a name".
std::string Describe(TokenKind kind);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_TOKEN_H_
